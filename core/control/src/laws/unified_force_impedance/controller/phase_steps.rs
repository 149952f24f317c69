//! The phases of a task, step by step: tare, visual alignment, descent, touchdown, policy,
//! retraction, and the return after an interruption.

use nalgebra::Vector3;
use tangent_sensing::Validity;

use super::super::fused_normal::NormalInUse;
use super::super::interface::UnifiedInput;
use super::super::law::{ArmNow, ForceLoop, MotionReference};
use super::super::orientation::OrientationReference;
use super::run::Lay;
use super::{Felt, UnifiedForceImpedance, Wanted, at_rest};
use crate::laws::torque_task::TorqueLaw;
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;

/// ρ_align from which it counts as full: the arm must not be compliant when it starts to press
/// after the approach.
const FULL_RHO: f64 = 0.99;
/// Time above the threshold that counts as a touch, s.
const TOUCH_S: f64 = 0.003;
/// ρ_align below which the arm is compliant, increasingly so towards 0.
const LIMP_RHO: f64 = 0.1;
/// Time constant with which the position of a compliant arm becomes the desired one, s.
const YIELD_S: f64 = 0.05;
/// Time constant with which a tool without a usable wrench comes to rest, s.
const STAY_S: f64 = 0.02;
/// Time constant with which a change of the policy's acceleration is passed on, s.
const JERK_S: f64 = 0.02;
/// Time constant with which a displaced policy returns to its original place, s.
const RETURN_S: f64 = 1.0;

/// Whether the wrench is missing or invalid.
fn is_deaf(felt: &Felt) -> bool {
    matches!(
        felt.verdict,
        WrenchVerdict::Stop(_) | WrenchVerdict::Retract(_)
    )
}

impl<const N: usize> UnifiedForceImpedance<N> {
    /// Advances the phases and returns the reference of the tool.
    pub(super) fn advance(
        &mut self,
        input: &UnifiedInput<N>,
        now: &ArmNow<N>,
        normal: &NormalInUse,
        felt: &Felt,
    ) -> Wanted {
        let dt = input.dt_s;
        let good = felt.verdict == WrenchVerdict::Good;
        if is_deaf(felt) && self.task.phase.is_pressing() {
            // Without a wrench the force cannot be controlled: stand still.
            self.task.enter(Phase::Hold);
            self.run.rate = 0.0;
            return self.hold(now);
        }
        match self.task.phase {
            Phase::Tare => {
                self.tare(input, now, good);
                self.hold(now)
            }
            Phase::Clear => self.clear(now, felt, dt),
            Phase::Approach => self.approach(now, normal, felt, dt),
            Phase::Contact | Phase::Slide | Phase::Hold => self.press(now, normal, felt, dt),
            Phase::Seek => self.seek(now, normal, felt, dt),
            Phase::Retract => self.retract(now, felt, dt),
            // These laws neither travel nor lift off between strokes: such programs are refused.
            Phase::Travel | Phase::Lift | Phase::Idle | Phase::Done | Phase::Fault => {
                self.hold(now)
            }
        }
    }

    fn tare(&mut self, input: &UnifiedInput<N>, now: &ArmNow<N>, good: bool) {
        let tared = !self.task.program.task.tare
            || self.task.phase_s >= self.task.program.config.touch.tare_s;
        if self.task.paused {
            return;
        }
        if good && tared && input.arm_ready {
            if self.task.program.task.tare {
                let zero = self.run.zero.0 / self.run.zero.1.max(1.0);
                if zero.fixed_rows::<3>(0).norm() > self.task.program.config.touch.zero_max_n {
                    return self.fail(Fault::ZeroTooLarge);
                }
                self.run.zeroed_s = Some(self.task.elapsed_s);
                self.run.tared_at = Some(now.tool.translation());
            }
            self.run.held = None;
            self.task.enter(Phase::Approach);
        } else if self.task.phase_s > self.task.program.task.timeouts.tare_s {
            self.fail(match (input.arm_ready, good) {
                (false, _) => Fault::ArmNotReady,
                (_, false) => Fault::Wrench(input.wrench_validity),
                _ => Fault::NoTare,
            });
        }
    }

    pub(super) fn orientation(&mut self, now: &ArmNow<N>) -> OrientationReference {
        *self
            .run
            .orientation
            .get_or_insert_with(|| OrientationReference::new(now.tool.rotation()))
    }

    /// Rotates the reference with the surface.
    fn turn(&mut self, now: &ArmNow<N>, normal: &NormalInUse, velocity: &Vector3<f64>, dt: f64) {
        let mut orientation = self.orientation(now);
        if normal.validity == Validity::Missing {
            orientation.hold();
        } else {
            orientation.step(
                &self.task.program.config.orientation,
                normal,
                &now.tool.rotation(),
                velocity,
                dt,
            );
        }
        self.run.orientation = Some(orientation);
    }

    /// Stands still. If the tool was pressing, the spring that takes over keeps its push: the
    /// reference lies below the surface.
    pub(super) fn hold(&mut self, now: &ArmNow<N>) -> Wanted {
        let mut orientation = self.orientation(now);
        orientation.hold();
        self.run.orientation = Some(orientation);
        let below = self.push_direction(now)
            * (self.run.push_n / self.task.program.config.impedance.free_stiffness_n_per_m);
        let position = *self.run.held.get_or_insert(now.tool.translation() + below);
        Wanted {
            reference: at_rest(position, &orientation),
            policy: position,
            pressing: false,
        }
    }

    /// First aligns with the measured normal, then descends until contact.
    fn approach(&mut self, now: &ArmNow<N>, normal: &NormalInUse, felt: &Felt, dt: f64) -> Wanted {
        self.turn(now, normal, &Vector3::zeros(), dt);
        let start = *self.run.held.get_or_insert(now.tool.translation());
        let touch = self.task.program.config.touch;
        let tilt = normal.normal.angle(&-now.tool.z_axis());
        let ready = !normal.validity.is_valid()
            || (tilt < touch.aligned_rad && self.run.monitor.rho >= FULL_RHO);
        let (mut way, mut speed) = self.run.approach;
        let change = self.task.program.config.path.acceleration_m_per_s2 * dt;
        if is_deaf(felt) {
            // Without a usable wrench the tool waits: it could not detect contact.
            speed = (speed - self.limits.acceleration_max_m_per_s2 * dt).max(0.0);
        } else if self.task.paused {
            speed = (speed - change).max(0.0);
        } else if way > 0.0 || ready || self.task.phase_s > touch.align_s {
            speed = (speed + change).min(self.task.program.task.approach.speed_m_per_s);
        }
        way += speed * dt;
        self.run.approach = (way, speed);
        let direction = self.task.program.task.approach.direction.in_base(&now.tool);
        let start = self.stay(now, felt, start, &(direction * way), dt);
        let strong = felt.pressing_now_n().is_some_and(|n| n > touch.on_n);
        self.run.strong_s = if strong { self.run.strong_s + dt } else { 0.0 };
        let position = start + direction * way;
        let orientation = self.orientation(now);
        let mut reference = at_rest(position, &orientation);
        reference.velocity = direction * speed;
        if self.run.strong_s + 0.5 * dt >= TOUCH_S {
            let at = now.tool.translation();
            let tared_at = self.run.tared_at.take();
            if tared_at
                .is_some_and(|p| (at - p).norm() < self.task.program.config.leave.touch_at_once_m)
            {
                // The next start takes its own zero: this one ends with the task.
                self.fail(Fault::ZeroInContact);
                return self.hold(now);
            }
            self.touch_down(now, &direction, &position);
        } else if way > self.task.program.task.approach.distance_max_m {
            self.fail(Fault::NoSurface);
        }
        Wanted {
            reference,
            policy: position,
            pressing: false,
        }
    }

    /// Start of a motion: a tool without a usable wrench stays where it is, and continues from
    /// there.
    fn stay(
        &mut self,
        now: &ArmNow<N>,
        felt: &Felt,
        start: Vector3<f64>,
        way: &Vector3<f64>,
        dt: f64,
    ) -> Vector3<f64> {
        if !is_deaf(felt) {
            return start;
        }
        let behind = now.tool.translation() - (start + way);
        let start = start + behind * (dt / STAY_S).min(1.0);
        self.run.held = Some(start);
        start
    }

    /// Places the policy where the tool touched; the force controller takes over the push of the
    /// approach's spring.
    fn touch_down(&mut self, now: &ArmNow<N>, direction: &Vector3<f64>, reference: &Vector3<f64>) {
        let up = -direction;
        let at = now.tool.translation();
        let x = self.task.program.task.plane.x_axis.in_base(&now.tool);
        let x = (x - up * up.dot(&x)).normalize();
        self.run.lay = Some(Lay {
            origin: at,
            x,
            y: up.cross(&x),
            up,
        });
        let pushing = self.push_direction(now).dot(&(reference - at))
            * self.task.program.config.impedance.free_stiffness_n_per_m;
        self.task.departure.touched();
        self.run.path_s = 0.0;
        self.begin_pressing(pushing, at);
        self.task.enter(Phase::Contact);
    }

    fn begin_pressing(&mut self, pushing_n: f64, at: Vector3<f64>) {
        self.run.reference_n = pushing_n
            .max(0.0)
            .min(self.task.program.task.force.reference_n);
        self.run.force = ForceLoop::default();
        self.run.last_contact = at;
        self.run.weak_s = 0.0;
        self.run.strong_s = 0.0;
        self.run.rate = 0.0;
        self.run.held = None;
    }

    fn press(&mut self, now: &ArmNow<N>, normal: &NormalInUse, felt: &Felt, dt: f64) -> Wanted {
        let Some(lay) = self.run.lay else {
            return self.hold(now);
        };
        self.run.held = None;
        self.keep_contact(now, felt, dt);
        let step = self.task.program.config.force.reference_rate_n_per_s * dt;
        let away = self.task.program.task.force.reference_n - self.run.reference_n;
        self.run.reference_n += away.max(-step).min(step);
        let rate = self.keep_time(normal, felt, dt);
        let at = self.task.program.path.at(self.run.path_s);
        let drawn = lay.origin + lay.x * at.position.x + lay.y * at.position.y;
        let velocity = (lay.x * at.velocity.x + lay.y * at.velocity.y) * rate;
        let (policy, velocity) = self.on_surface(now, &lay, drawn, velocity, dt);
        self.turn(now, normal, &velocity, dt);
        let orientation = self.orientation(now);
        // A stopping clock or a turning normal must not cause a jerk.
        let acceleration = crate::limits::clamp_norm(
            (velocity - self.run.last_velocity) / dt,
            self.limits.acceleration_max_m_per_s2,
        );
        self.run.last_velocity = velocity;
        self.run.acceleration += (acceleration - self.run.acceleration) * (dt / (JERK_S + dt));
        Wanted {
            reference: MotionReference {
                position: policy,
                velocity,
                acceleration: self.run.acceleration,
                rotation: orientation.rotation,
                angular: orientation.angular,
            },
            policy,
            pressing: true,
        }
    }

    /// Counts contact losses; a tool that has lost the surface seeks it, if the law is configured
    /// to.
    fn keep_contact(&mut self, now: &ArmNow<N>, felt: &Felt, dt: f64) {
        let touch = self.task.program.config.touch;
        let weak = felt.pressing_now_n().is_some_and(|n| n < touch.off_n);
        if !weak {
            self.run.weak_s = 0.0;
            self.run.last_contact = now.tool.translation();
            return;
        }
        // Half a period: a time is a whole number of periods, rounded.
        let lost = |weak_s: f64| weak_s + 0.5 * dt >= touch.lost_s;
        let lost_before = lost(self.run.weak_s);
        self.run.weak_s += dt;
        if lost(self.run.weak_s) && !lost_before {
            self.run.lost_count += 1;
            if touch.seek {
                self.run.sought_m = 0.0;
                self.run.rate = 0.0;
                self.run.held = Some(now.tool.translation());
                self.task.enter(Phase::Seek);
            }
        }
    }

    /// Advances the policy's clock. It runs as fast as the stiffness of the arm allows, and stands
    /// while an input is missing. Returns its rate.
    fn keep_time(&mut self, normal: &NormalInUse, felt: &Felt, dt: f64) -> f64 {
        let ended = self.run.path_s >= self.task.program.path.duration_s();
        let sees = self.run.blind_s <= self.task.program.config.patience.estimate_s;
        let settled = self.task.phase_s >= self.task.program.config.touch.settle_s;
        match self.task.phase {
            Phase::Contact if settled && !self.task.paused => {
                let wanted_n = self.task.program.task.force.reference_n;
                let near = felt
                    .pressing_n
                    .is_some_and(|n| (wanted_n - n).abs() < 0.3 * wanted_n);
                if near || self.task.phase_s > self.task.program.task.timeouts.contact_s {
                    self.task.enter(Phase::Slide);
                }
            }
            Phase::Slide if ended || (!sees && self.run.rate <= 0.0) => {
                self.task.enter(Phase::Hold)
            }
            Phase::Hold
                if ended
                    && !self.task.paused
                    && self.task.phase_s >= self.task.program.task.end.hold_s =>
            {
                self.leave(Phase::Done);
            }
            Phase::Hold if !ended && normal.validity.is_valid() => self.task.enter(Phase::Slide),
            _ => {}
        }
        let touches = self.run.weak_s + 0.5 * dt < self.task.program.config.touch.pause_s;
        let going = self.task.phase == Phase::Slide
            && sees
            && touches
            && !is_deaf(felt)
            && !self.task.paused;
        let step = dt / self.task.program.config.path.clock_ramp_s.max(dt);
        let change = if going { step } else { -step };
        self.run.rate = (self.run.rate + change).clamp(0.0, 1.0);
        // Without energy for its springs, the policy would advance without the tool.
        let valve = self.run.tanks.motion_valve(&self.task.program.config.tanks);
        let rate = self.run.rate * self.run.monitor.rho * valve;
        self.run.path_s += rate * dt;
        rate
    }

    /// The policy's point and velocity, mapped to the surface for the tool.
    fn on_surface(
        &mut self,
        now: &ArmNow<N>,
        lay: &Lay,
        drawn: Vector3<f64>,
        velocity: Vector3<f64>,
        dt: f64,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let at = now.tool.translation();
        // The paper: a compliant arm's pose becomes the desired one, and the policy continues from
        // there. ρ_align never reaches 0 by itself: while C is beyond its margin, ρ_align settles
        // where its decay and ρ_min balance.
        let rho = self.run.monitor.rho;
        let limp = (1.0 - rho / LIMP_RHO).max(0.0) * (dt / YIELD_S).min(1.0);
        self.run.offset += (at - drawn - self.run.offset) * limp;
        let up = lay.up * lay.up.dot(&self.run.offset);
        let across = self.run.offset - up;
        self.run.offset = up + across * (1.0 - rho * dt / RETURN_S);
        let mut point = drawn + self.run.offset;
        let n = self.smooth_normal(now);
        let slope = n.dot(&lay.up);
        if !self.task.program.config.shaping.from_last_contact || slope < 0.2 {
            return (point, velocity);
        }
        // At the height of the plane under the tool, so that the error lies in that plane.
        point += lay.up * (n.dot(&(at - point)) / slope);
        (point, velocity - lay.up * (n.dot(&velocity) / slope))
    }

    /// Moves slowly against the normal until contact is detected again.
    fn seek(&mut self, now: &ArmNow<N>, normal: &NormalInUse, felt: &Felt, dt: f64) -> Wanted {
        self.turn(now, normal, &Vector3::zeros(), dt);
        let touch = self.task.program.config.touch;
        let direction = -self.smooth_normal(now);
        let start = *self.run.held.get_or_insert(now.tool.translation());
        let strong = felt.pressing_now_n().is_some_and(|n| n > touch.on_n);
        self.run.strong_s = if strong { self.run.strong_s + dt } else { 0.0 };
        let speed = if is_deaf(felt) || self.task.paused {
            0.0
        } else {
            touch.seek_speed_m_per_s
        };
        self.run.sought_m += speed * dt;
        let start = self.stay(now, felt, start, &(direction * self.run.sought_m), dt);
        let position = start + direction * self.run.sought_m;
        let orientation = self.orientation(now);
        if self.run.strong_s + 0.5 * dt >= TOUCH_S {
            let pushing = direction.dot(&(position - now.tool.translation()))
                * self.task.program.config.impedance.free_stiffness_n_per_m;
            self.begin_pressing(pushing, now.tool.translation());
            self.task.enter(if self.run.path_s > 0.0 {
                Phase::Slide
            } else {
                Phase::Contact
            });
        } else if self.run.sought_m > self.limits.blind_distance_max_m {
            self.fail(Fault::SurfaceLost);
        }
        let mut reference = at_rest(position, &orientation);
        reference.velocity = direction * speed;
        Wanted {
            reference,
            policy: position,
            pressing: false,
        }
    }
}
