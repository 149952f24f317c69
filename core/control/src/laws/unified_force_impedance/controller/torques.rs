//! The torques of one period, eq. (73), within the limits of the tanks, the motors and their rates.

use nalgebra::{Vector3, Vector6};
use tangent_mechanics::Joints;

use super::super::energy::TorqueParts;
use super::super::law::{ArmNow, Impedance, before_the_ends, posture};
use super::{Felt, UnifiedForceImpedance, Wanted, twist_of};
use crate::laws::stacked::stacked;
use crate::limits::clamp_norm;
use crate::limits::joint_guard::bounded_torque;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;

/// Speed below which no direction of sliding is defined, m/s.
const SLIDING_M_PER_S: f64 = 0.01;
/// Time constant of the friction estimate on the surface, s.
const FRICTION_TIME_S: f64 = 0.5;
/// Upper bound of the friction coefficient.
const FRICTION_MAX: f64 = 1.2;
/// Time constant of the transition between pressing and free motion, s.
const BRIDGE_S: f64 = 0.025;
/// Share of the motors' rate limit that the law uses.
const RATE_SHARE: f64 = 0.98;

impl<const N: usize> UnifiedForceImpedance<N> {
    /// Torques to command (Nm), and the pressing force they aim at (N).
    #[allow(clippy::too_many_arguments)]
    pub(super) fn torques(
        &mut self,
        wanted: &Wanted,
        now: &ArmNow<N>,
        felt: &Felt,
        error: &Vector6<f64>,
        rho_force: f64,
        dt: f64,
    ) -> (Joints<N>, f64) {
        let config = &self.task.program.config;
        // A measurement is as old as the loop's delay, plus half a period on average.
        let delay_s = (self.interface.delay_periods as f64 + 1.5) * dt;
        let impedance = Impedance::new(&config.impedance, now, wanted.pressing, delay_s);
        let limp = wanted.pressing || self.task.phase == Phase::Tare;
        let rho = if limp { self.run.monitor.rho } else { 1.0 };
        let mut spring = -impedance.stiffness.component_mul(error);
        // Eq. (19): only translations are shaped.
        for i in 0..3 {
            spring[i] *= rho;
        }
        let twist = now.in_tool(&stacked(&now.linear, &now.angular));
        let damper = -impedance.damping.component_mul(&twist);
        let mut active = now.in_base(&spring);
        let reference = &wanted.reference;
        if config.impedance.feed_forward {
            let moving = now.in_tool(&twist_of(reference));
            active += now.in_base(&impedance.damping.component_mul(&moving));
            active += now.wrench_for(&stacked(&reference.acceleration, &Vector3::zeros()));
            active += stacked(
                &self.on_the_surface(wanted, now, felt, dt),
                &Vector3::zeros(),
            );
        }
        let config = &self.task.program.config;
        let (spare, spare_damper) = posture(&config.posture, &self.model, now);
        let rubbed = self
            .friction
            .torque(&now.joint_velocity(&twist_of(reference)));
        let damping = now.jacobian.tr_mul(&now.in_base(&damper)) + spare_damper;

        let shaped = self.run.reference_n * rho_force;
        let (push_n, reference_n) = match felt.verdict {
            _ if !wanted.pressing => (0.0, 0.0),
            WrenchVerdict::Good => {
                let push = self
                    .run
                    .force
                    // No error without a measurement.
                    .step(
                        &config.force,
                        shaped,
                        felt.pressing_n.unwrap_or(shaped),
                        rho_force,
                        dt,
                    );
                // Eq. (31): ρ_frc scales the controller's whole output.
                (shaped + (push - shaped) * rho_force, shaped)
            }
            // During one invalid sample the push stays as it was.
            WrenchVerdict::Doubtful => (self.run.push_n, shaped),
            WrenchVerdict::Stop(_) | WrenchVerdict::Retract(_) => (0.0, 0.0),
        };
        self.run.push_n = push_n;
        let push = self.push_direction(now) * push_n;
        let force = stacked(&push, &Vector3::zeros());
        let active = active + self.bridge(wanted.pressing, &(active + force), dt);
        let motion = now.jacobian.tr_mul(&active) + spare + rubbed;
        let force = now.jacobian.tr_mul(&force);

        let tanks = &self.task.program.config.tanks;
        let heading_w = motion.dot(&now.qd);
        let slowed = (tanks.power_max_w / heading_w.max(tanks.power_max_w)).min(1.0);
        let along = self.push_direction(now).dot(&now.linear);
        let share = self.run.tanks.force_share(tanks, push_n, along);
        let parts = TorqueParts {
            motion: motion * (self.run.tanks.motion_valve(tanks) * slowed),
            force: force * share,
            damping,
        };
        (self.within_limits(parts, now, dt), reference_n)
    }

    /// Smooths the transition between pressing and free motion: a wrench that only one of them asks
    /// for fades out instead of ending abruptly. Returns the wrench to add to `asked`, base axes.
    fn bridge(&mut self, pressing: bool, asked: &Vector6<f64>, dt: f64) -> Vector6<f64> {
        let run = &mut self.run;
        if run.was_pressing != pressing {
            run.was_pressing = pressing;
            run.bridge = run.last_wrench - asked;
        }
        run.bridge *= 1.0 - (dt / BRIDGE_S).min(1.0);
        run.last_wrench = asked + run.bridge;
        run.bridge
    }

    /// Compensates the surface's effect on a sliding tool: its friction, estimated online, and the
    /// integral of the remaining error. N, base axes.
    fn on_the_surface(
        &mut self,
        wanted: &Wanted,
        now: &ArmNow<N>,
        felt: &Felt,
        dt: f64,
    ) -> Vector3<f64> {
        let n = self.smooth_normal(now);
        let across = |v: &Vector3<f64>| v - n * n.dot(v);
        let stopped = matches!(
            felt.verdict,
            WrenchVerdict::Stop(_) | WrenchVerdict::Retract(_)
        );
        if !wanted.pressing || stopped {
            self.run.drawn = Vector3::zeros();
            return Vector3::zeros();
        }
        let sliding = across(&now.linear);
        let speed = sliding.norm();
        let pressing = felt.wrench.zip(felt.pressing_n).filter(|(_, n)| *n > 2.0);
        if self.task.phase == Phase::Slide
            && speed > SLIDING_M_PER_S
            && let Some((wrench, pressing_n)) = pressing
        {
            let force = now.tool.rotate(&wrench.fixed_rows::<3>(0).into_owned());
            let seen = -force.dot(&sliding) / (speed * pressing_n);
            let seen = seen.clamp(0.0, FRICTION_MAX);
            self.run.surface_friction +=
                (seen - self.run.surface_friction) * (dt / FRICTION_TIME_S);
        }
        let c = &self.task.program.config.impedance;
        let away = across(&(wanted.reference.position - now.tool.translation()));
        let gain = c.stiffness_n_per_m[0] * c.integral_per_s * self.run.monitor.rho * dt;
        let drawn = across(&(self.run.drawn + away * gain));
        self.run.drawn = clamp_norm(drawn, c.integral_max_n);
        // Along the reference's motion, blended in with its speed: the friction estimate alone has
        // no direction.
        let way = across(&wanted.reference.velocity);
        let along = way / way.norm().max(SLIDING_M_PER_S);
        self.run.drawn + along * (self.run.surface_friction * self.run.reference_n)
    }

    /// Gravity plus `wanted` within the motors' limits. A torque limit scales all parts equally. If
    /// a rate limit holds a joint back, each of its parts has moved by the same share: the accounts
    /// contain the torques in effect, part by part. If one part were booked in full and the
    /// difference against it, the two tanks would exchange energy for work that is not done.
    fn within_limits(&mut self, wanted: TorqueParts<N>, now: &ArmNow<N>, dt: f64) -> Joints<N> {
        let interface = &self.interface;
        let mut limits = *self.model.limits();
        limits.effort = limits.effort.map(|effort| effort * interface.effort_share);
        let ends = before_the_ends(&self.model, self.limits.joint_margin_rad, &now.q);
        let held = if interface.gravity_by_arm {
            ends
        } else {
            now.gravity + ends
        };
        // Springs far beyond a joint's end stop can exceed the motors' torque.
        let held = bounded_torque(&limits, &held, &Joints::zeros()).0;
        let (possible, left) = bounded_torque(&limits, &held, &wanted.sum());
        let before = self.run.torque.unwrap_or(held);
        if !possible.iter().all(|x| x.is_finite()) {
            // The previous torques stay in effect for this period, accounted to the motion tank.
            self.run.limited = true;
            self.run.lost = true;
            self.run.tanks.commit(TorqueParts {
                motion: before - held,
                ..TorqueParts::zero()
            });
            self.run.held_torque = held;
            return before;
        }
        let (mut torque, mut gone) = (possible, Joints::<N>::repeat(1.0));
        if let Some(rate) = limits.effort_rate {
            for i in 0..N {
                let (step, away) = (
                    rate[i] * dt * interface.rate_share * RATE_SHARE,
                    possible[i] - before[i],
                );
                torque[i] = before[i] + away.max(-step).min(step);
                gone[i] = (step / away.abs()).min(1.0);
            }
        }
        self.run.limited = left < 1.0 || gone.min() < 1.0;
        let mut parts = self.run.tanks.committed().towards(&(wanted * left), &gone);
        // The torque that holds the arm has changed since the last period.
        parts.motion += torque - held - parts.sum();
        self.run.tanks.commit(parts);
        self.run.torque = Some(torque);
        self.run.held_torque = held;
        torque
    }
}
