//! The phases of a task, step by step: tare, descent, touchdown, path, retraction, and the return
//! after an interruption.

use tangent_estimation::ObjectEstimate;
use tangent_mechanics::{Base, Object, Pose};
use tangent_sensing::Validity;

use super::super::HybridInput;
use super::super::law::{ArmNow, ForceIntegral, MotionReference};
use super::super::reference::{Descent, Exploration, ObjectReference, SurfacePath};
use super::{Felt, HybridDynamics, Wanted};
use crate::laws::torque_task::TorqueLaw;
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;

impl<const N: usize> HybridDynamics<N> {
    /// Advances the phases and returns the reference of the tool.
    pub(super) fn advance(
        &mut self,
        input: &HybridInput<N>,
        now: &ArmNow<N>,
        estimate: Option<&ObjectEstimate>,
        felt: Option<&Felt>,
        verdict: WrenchVerdict,
    ) -> Wanted {
        let dt = input.dt_s;
        let good = felt.is_some();
        let stopped = matches!(verdict, WrenchVerdict::Stop(_));
        self.keep_time(estimate.is_some() && !stopped && !self.task.paused, dt);
        match self.task.phase {
            Phase::Tare => {
                let tared = !self.task.program.task.tare
                    || input
                        .bias_age_s
                        .is_some_and(|age| age < self.task.phase_s - 1e-9);
                if self.task.paused {
                    return self.hold(now);
                }
                if tared && good && input.arm_ready {
                    if let Some(e) = estimate {
                        self.begin_descent(now, e);
                    } else if self.task.phase_s > self.task.program.task.timeouts.tare_s {
                        self.fail(Fault::Estimate(
                            input.estimate.map_or(Validity::Missing, |e| e.validity),
                        ));
                    }
                } else if self.task.phase_s > self.task.program.task.timeouts.tare_s {
                    self.fail(if input.arm_ready {
                        Fault::NoTare
                    } else {
                        Fault::ArmNotReady
                    });
                }
                self.hold(now)
            }
            Phase::Clear => self.clear(input, now, felt, verdict),
            Phase::Approach => self.approach(now, felt, dt),
            Phase::Contact | Phase::Slide | Phase::Hold | Phase::Seek => {
                if stopped {
                    // Without a wrench the force cannot be controlled: stand still.
                    self.task.enter(Phase::Hold);
                    return self.hold(now);
                }
                self.run.held = None;
                self.press(now, estimate, felt, dt)
            }
            Phase::Retract => self.retract(input, now, felt),
            // These laws neither travel nor lift off between strokes: such programs are refused.
            Phase::Travel | Phase::Lift | Phase::Idle | Phase::Done | Phase::Fault => {
                self.hold(now)
            }
        }
    }

    /// Slows the reference's clock to a stop while an input is missing, and speeds it up again
    /// after.
    fn keep_time(&mut self, going: bool, dt: f64) {
        let step = dt / self.task.program.config.path.clock_ramp_s.max(dt);
        let change = if going { step } else { -step };
        self.run.rate = (self.run.rate + change).clamp(0.0, 1.0);
    }

    pub(super) fn hold(&mut self, now: &ArmNow<N>) -> Wanted {
        let pose = *self.run.held.get_or_insert(now.tool);
        Wanted {
            reference: MotionReference::at_rest(&pose),
            in_object: None,
            pressing: false,
            seek_m_per_s: None,
        }
    }

    fn begin_descent(&mut self, now: &ArmNow<N>, estimate: &ObjectEstimate) {
        let Some(in_object) = self.object_from_tool(now) else {
            return;
        };
        let n = self.constraint(now).normal;
        let sd = n
            .dot(&(estimate.covariance.fixed_view::<3, 3>(0, 0) * n))
            .max(0.0)
            .sqrt();
        self.run.descent = Some(Descent::new(
            &*self.surface,
            &in_object,
            self.task.program.task.approach.speed_m_per_s,
            (
                self.task.program.config.path.acceleration_m_per_s2,
                self.task.program.config.path.jerk_m_per_s3,
            ),
            self.task.program.config.estimate.slow_within_sd * sd,
        ));
        self.run.held = None;
        self.run.rate = 0.0;
        self.run.tared_at = self.task.program.task.tare.then(|| now.tool.translation());
        self.task.enter(Phase::Approach);
    }

    fn approach(&mut self, now: &ArmNow<N>, felt: Option<&Felt>, dt: f64) -> Wanted {
        let (Some(mut descent), Some(object)) = (self.run.descent, self.run.object) else {
            return self.hold(now);
        };
        let touch = &self.task.program.config.touch;
        descent.step(
            self.run.rate,
            touch.seek_speed_m_per_s,
            self.task.program.config.path.acceleration_m_per_s2,
            dt,
        );
        self.run.descent = Some(descent);
        let reference = descent.at(self.run.rate);
        let touching = felt.filter(|felt| felt.pressing_n > touch.on_n);
        if let Some(felt) = touching {
            let at = now.tool.translation();
            let tared_at = self.run.tared_at.take();
            if tared_at
                .is_some_and(|p| (at - p).norm() < self.task.program.config.leave.touch_at_once_m)
            {
                self.run.zero_withdrawn = true;
                self.fail(Fault::ZeroInContact);
                return self.hold(now);
            }
            self.touch_down(&reference, object.pose(), now, felt.pressing_n);
        } else if descent.beyond_m() > touch.seek_distance_max_m {
            self.fail(Fault::NoSurface);
        }
        Wanted {
            in_object: Some(reference.position),
            reference: reference.in_base(&object),
            pressing: false,
            seek_m_per_s: None,
        }
    }

    fn touch_down(
        &mut self,
        reference: &ObjectReference,
        object: &Pose<Base, Object>,
        now: &ArmNow<N>,
        pressing_n: f64,
    ) {
        let x = object.unrotate(&self.task.program.task.plane.x_axis.in_base(&now.tool));
        self.run.lay = Some(SurfacePath::new(
            &*self.surface,
            &reference.position,
            &x,
            &reference.rotation,
        ));
        self.task.departure.touched();
        self.run.path_s = 0.0;
        self.run.exploration = None;
        self.run.reference_n = pressing_n.min(self.task.program.task.force.reference_n);
        self.run.force = ForceIntegral::default();
        self.task.enter(Phase::Contact);
    }

    fn press(
        &mut self,
        now: &ArmNow<N>,
        estimate: Option<&ObjectEstimate>,
        felt: Option<&Felt>,
        dt: f64,
    ) -> Wanted {
        let seen = estimate.is_some() && !self.task.paused;
        let (Some(lay), Some(object)) = (self.run.lay, self.run.object) else {
            return self.hold(now);
        };
        let touch = self.task.program.config.touch;
        self.run.weak_s = if felt.is_some_and(|felt| felt.pressing_n < touch.off_n) {
            self.run.weak_s + dt
        } else {
            0.0
        };
        let seek_m_per_s = if self.task.paused {
            0.0
        } else {
            touch.seek_speed_m_per_s
        };
        if self.task.phase == Phase::Seek {
            self.run.sought_m += seek_m_per_s * dt;
            if let Some(felt) = felt.filter(|felt| felt.pressing_n > touch.on_n) {
                self.run.force = ForceIntegral::default();
                self.run.reference_n = felt
                    .pressing_n
                    .min(self.task.program.task.force.reference_n);
                self.resume();
            } else if self.run.sought_m > self.limits.blind_distance_max_m {
                self.fail(Fault::SurfaceLost);
            }
        } else if self.run.weak_s + 0.5 * dt >= touch.lost_s {
            self.run.lost_count += 1;
            self.run.sought_m = 0.0;
            self.task.enter(Phase::Seek);
        } else {
            let step = self.task.program.config.force.reference_rate_n_per_s * dt;
            let wanted = self.task.program.task.force.reference_n;
            self.run.reference_n += (wanted - self.run.reference_n).clamp(-step, step);
        }
        self.explore(now, estimate, felt, dt);
        self.along_the_path(seen, dt);
        let moving = matches!(self.task.phase, Phase::Slide | Phase::Contact);
        let rate = if moving { self.run.rate } else { 0.0 };
        let exploring = self.run.exploration.filter(|e| !e.is_done());
        let reference = if let Some(exploration) = exploring {
            lay.exploring(&*self.surface, &exploration, rate)
        } else {
            let sliding = self.task.phase == Phase::Slide;
            let rate = if sliding { rate } else { 0.0 };
            let path = &self.task.program.path;
            lay.at(&*self.surface, path, self.run.path_s, rate)
        };
        Wanted {
            in_object: Some(reference.position),
            reference: reference.in_base(&object),
            pressing: true,
            seek_m_per_s: (self.task.phase == Phase::Seek).then_some(seek_m_per_s),
        }
    }

    /// Slides a small circle after the touchdown if the normal of the estimate is uncertain, once
    /// half of the force is there. Its clock stops with that of the path.
    fn explore(
        &mut self,
        now: &ArmNow<N>,
        estimate: Option<&ObjectEstimate>,
        felt: Option<&Felt>,
        dt: f64,
    ) {
        if self.task.phase != Phase::Contact {
            return;
        }
        if let Some(exploration) = &mut self.run.exploration {
            exploration.step(self.run.rate * dt);
            return;
        }
        let touch = self.task.program.config.touch;
        let half = 0.5 * self.task.program.task.force.reference_n;
        let pressed = felt.is_some_and(|felt| felt.pressing_n >= half);
        let (true, Some(estimate)) = (pressed && touch.explore_radius_m > 0.0, estimate) else {
            return;
        };
        let normal = estimate.normal_at(&*self.surface, &now.tool.translation());
        if normal.covariance.trace() > touch.explore_above_rad.powi(2) {
            let path = &self.task.program.config.path;
            let bounds = (path.acceleration_m_per_s2, path.jerk_m_per_s3);
            self.run.exploration = Some(Exploration::new(touch.explore_radius_m, bounds));
        }
    }

    /// Advances settling, sliding, and holding where the path ended or the object is out of view.
    fn along_the_path(&mut self, seen: bool, dt: f64) {
        let ended = self.run.path_s >= self.task.program.path.duration_s();
        match self.task.phase {
            Phase::Contact
                if !self.task.paused
                    && self.run.exploration.is_none_or(|e| e.is_done())
                    && self.task.phase_s >= self.task.program.config.touch.settle_s =>
            {
                self.run.rate = 0.0;
                self.task.enter(Phase::Slide);
            }
            Phase::Slide => {
                self.run.path_s += self.run.rate * dt;
                if ended || (!seen && self.run.rate <= 0.0) {
                    self.task.enter(Phase::Hold);
                }
            }
            Phase::Hold
                if ended
                    && !self.task.paused
                    && self.task.phase_s >= self.task.program.task.end.hold_s =>
            {
                self.leave(Phase::Done);
            }
            Phase::Hold if seen && !ended => self.resume(),
            _ => {}
        }
    }
}
