//! Evaluation of the measurements of one cycle: whether the wrench can be used, whether the tool
//! touches, and which normal is in use. Called by the controller each cycle, before `decisions`.

use nalgebra::Vector3;
use tangent_mechanics::{Flange, Pose, Tool};
use tangent_sensing::Validity;

use super::config::ControllerConfig;
use super::interface::ControlInput;
use super::moving_base::MovingBase;
use super::percept::Percept;
use super::run::{HoldReason, Run};
use super::stiffness::DEPTH_SD_M;
use super::surface::Surface;
use super::touchdown::{real_touch_n, touch_force_n};
use super::zero_doubt::ZeroJump;
use crate::estimator_choice::EstimateStatus;
use crate::estimator_choice::switching::ChoiceRules;
use crate::limits::Limits;
use crate::limits::answer::DepthRule;
use crate::limits::arm_force::{Moving, TwoForces};
use crate::limits::plausibility::is_wrench;
use crate::limits::reference_probe::ProbeRule;
use crate::limits::touch::{Doing, Touch};
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;
use crate::task::program::Program;

/// Slope by which the normal in use may be wrong: 20 degrees, because an estimator that works by
/// touch alone finds the normal only while sliding.
const SLOPE: f64 = 0.36;
/// Largest age of a wrench that is compared with the arm's own force, s.
const COMPARED_S: f64 = 0.02;
/// Longest time for which a gap as large as the error of a depth is no loss of contact, s.
const GAP_MAX_S: f64 = 0.25;
/// Distance from the tool's origin to an edge of the tip that may be the contact, m.
const TIP_RADIUS_M: f64 = 0.015;
/// Time constant of the mean force above the surface, s.
const ABOVE_S: f64 = 0.2;

impl Run {
    /// Evaluates the cycle's measurements: contact, normal, and validity of the wrench. `input` has
    /// been transformed by `moving_base`.
    pub fn perceive<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        input: &ControlInput<N>,
        moving_base: &MovingBase,
        reference_n: f64,
    ) -> Percept {
        let pose = &input.base_from_tool;
        let (position, z_tool) = (pose.translation(), pose.z_axis());
        if !self.begun {
            self.begin(program, config, input);
        }
        if std::mem::take(&mut self.starts_here) {
            self.phase_start = position;
        }
        let validity = self.answering(program, config, limits, input, reference_n);
        let verdict = if self.phase == Phase::Tare {
            WrenchVerdict::Good
        } else {
            self.guard.step(
                &config.patience,
                validity,
                is_wrench(&input.wrench),
                input.wrench_age_s,
                input.dt_s,
            )
        };
        let good = verdict == WrenchVerdict::Good && is_wrench(&input.wrench);
        let wrench = good.then(|| pose.align_wrench(&input.wrench));
        let on_surface = self.phase.is_pressing() || self.phase == Phase::Seek;
        let mut estimate = EstimateStatus::Waiting;
        if on_surface {
            let slid = if self.phase == Phase::Seek {
                Vector3::zeros()
            } else {
                input.twist.linear
            };
            let way = crate::contact::alignment::tangential(&slid, &self.surface.normal).norm()
                * input.dt_s;
            estimate = self.choice.step(
                &ChoiceRules::new(&config.normal, &config.patience, &program.task.switching),
                &input.estimates,
                &self.surface.normal,
                way,
                input.dt_s,
            );
            let usable = match &estimate {
                EstimateStatus::Usable(estimate) if self.phase != Phase::Seek => Some(estimate),
                _ => None,
            };
            self.estimated |= usable.is_some();
            if self.estimated {
                self.surface.step(&config.normal, usable, &slid, input.dt_s);
            } else {
                // Until there is an estimate, the surface is assumed to face the tool (Tugal et
                // al., IV.B.d): the torques alone align the tool.
                self.surface = Surface::new(-z_tool);
            }
        } else if !self.touched {
            self.surface = Surface::new(-z_tool);
        }
        if self.phase.is_pressing()
            && self.touched
            && input.base.is_none()
            && self.turn.step(
                &position,
                &self.surface.normal,
                config.normal.turn_max_rad,
                self.exploration.is_open(),
            )
        {
            self.response.misdirected();
        }
        let against = if self.touched {
            self.surface.normal
        } else {
            -self.approach
        };
        let force_n = wrench.map(|wrench| wrench.force.dot(&against));
        if let (Some(wrench), Some(force_n)) = (&wrench, force_n) {
            let aside_n = (wrench.force - against * force_n).norm();
            self.felt.add(force_n, aside_n, input.dt_s);
        }
        if self.phase.is_before_approach() {
            // Before the tare, an unloaded sensor may show any force.
            self.in_contact = false;
        } else if let Some(force_n) = force_n {
            self.feel(config, force_n, reference_n, input.dt_s);
        }
        Percept {
            position,
            position_in_base: moving_base.point(&position),
            base: input.base.and_then(|base| base.trouble),
            out_of_reach: moving_base.out_of_reach(),
            z_tool,
            wrench,
            verdict,
            untared: input.untared.filter(|_| good),
            force_n,
            estimate,
        }
    }

    /// Compares the force that the arm itself feels with the sensor's.
    pub fn compare_with_arm<const N: usize>(
        &mut self,
        limits: &Limits,
        flange_from_tool: &Pose<Flange, Tool>,
        input: &ControlInput<N>,
    ) {
        let good = input.wrench_validity.is_valid() && input.wrench_age_s <= COMPARED_S;
        let arm = input
            .arm_force
            .map(|force| flange_from_tool.unrotate(&force));
        let forces = TwoForces::of(arm, good.then_some(input.wrench.force));
        let stopped = match self.hold {
            HoldReason::NoWrench(from) if self.phase == Phase::Hold => Some(from),
            _ => None,
        };
        let moving = Moving::of(self.phase, stopped);
        let most_n = limits.unread_force_max_n;
        self.is_unread = self.arm_force.step(moving, forces, most_n, input.dt_s);
    }

    /// Validity of the wrench: as the input states it, or by how the wrench responds to the tool's
    /// motion.
    fn answering<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        input: &ControlInput<N>,
        reference_n: f64,
    ) -> Validity {
        match input.wrench_validity {
            Validity::Valid => {}
            Validity::ZeroJumped => match self.zero_jump(program, input) {
                ZeroJump::Proved => {}
                ZeroJump::ToProve => self.zero_doubt.ask(),
                ZeroJump::Fault => return Validity::ZeroJumped,
            },
            invalid => return invalid,
        }
        let pose = &input.base_from_tool;
        let normal = if self.touched {
            self.surface.normal
        } else {
            -self.approach
        };
        self.response.step(&Touch {
            doing: Doing::of(self.phase),
            position: pose.translation(),
            normal,
            wrench: input.wrench.vector(),
            force_n: pose.rotate(&input.wrench.force).dot(&normal),
            reference_n,
            stiffness_n_per_m: self.force.stiffness_measured_n_per_m(),
            gives_way: self.gives_way,
            rests: input.base.is_none(),
            fresh: input.wrench_age_s <= input.dt_s,
            depth: Some(DepthRule {
                settling: self.phase == Phase::Contact,
                slope: SLOPE,
                edge_speed_m_per_s: TIP_RADIUS_M * input.twist.angular.norm(),
                blind_max_m: limits.blind_distance_max_m,
                soft_tip: program.task.approach.soft_tip,
            }),
            probe: (config.force.probe_share > 0.0).then_some(ProbeRule {
                down_share: config.force.probe_share,
                in_effect_n: self.force.reference_n(),
                wanders: !self.knows_surface,
            }),
            dt_s: input.dt_s,
        })
    }

    /// Detects contact from the force, with hysteresis and a minimum duration against noise.
    fn feel(&mut self, config: &ControllerConfig, force_n: f64, reference_n: f64, dt_s: f64) {
        let contact = &config.contact;
        let touch = touch_force_n(config, reference_n);
        let lost = (contact.lost_share * reference_n)
            .max(0.5 * contact.noise_n)
            .min(0.7 * touch);
        // What the sensor shows above the surface is no touch on the way down.
        match self.phase {
            Phase::Lift if self.lift.is_over() => {
                self.above_n += (force_n - self.above_n) * dt_s / (dt_s + ABOVE_S);
            }
            Phase::Lift | Phase::Seek => {}
            _ => self.above_n = 0.0,
        }
        // The contact of a hop is known to be stiff: noise need not count as one.
        let touches_n = if self.phase == Phase::Seek && self.hops.is_under_way() {
            real_touch_n(config, reference_n)
        } else {
            touch
        };
        if force_n >= touches_n + self.above_n.clamp(0.0, contact.noise_n) {
            self.in_contact = true;
        }
        if force_n < lost {
            self.low_s += dt_s;
            // Where the law closes the arm's own ripple only slowly, a gap of that size is no loss.
            let closing_s = DEPTH_SD_M * self.force.damping_n_s_per_m() / reference_n;
            let patience_s = contact.lost_s.max(closing_s.min(GAP_MAX_S));
            if self.low_s + 0.5 * dt_s >= patience_s {
                self.in_contact = false;
            }
        } else {
            self.low_s = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::route::{Lifting, Route, Stage};
    use super::*;
    use crate::task::profile::Profile;

    const DT_S: f64 = 0.008;

    /// At 1 N the fourth such touch ended the task: something was in the way of the lift.
    #[test]
    fn what_the_sensor_shows_above_the_surface_is_no_touch_on_the_way_down() {
        let config = ControllerConfig::default();
        let reference_n = 1.1;
        let touch_n = touch_force_n(&config, reference_n);
        let route = Route {
            from: Vector3::zeros(),
            to: Vector3::x(),
            from_normal: Vector3::z(),
            to_normal: Vector3::z(),
            bulge_m: 0.0,
            lands: Vector3::x(),
            profile: Profile::new(1.0, 0.1, 1.0, 10.0),
            time_s: 0.0,
        };
        // Above the surface for a second, then on the way down.
        let touches = |above_n: f64, down_n: f64| {
            let mut run = Run::idle();
            run.phase = Phase::Lift;
            run.lift = Lifting {
                stage: Stage::Over(route),
                ..Lifting::idle()
            };
            for _ in 0..125 {
                run.feel(&config, above_n, reference_n, DT_S);
            }
            assert!(!run.in_contact, "{above_n} N above the surface");
            run.phase = Phase::Seek;
            run.feel(&config, down_n, reference_n, DT_S);
            run.in_contact
        };
        let (drift_n, more_n) = (0.9 * touch_n, 1.2 * touch_n);
        assert!(touches(0.0, more_n));
        assert!(!touches(drift_n, more_n));
        assert!(touches(drift_n, drift_n + more_n));
    }
}
