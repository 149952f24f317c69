//! The phases of a task around the law: tare, descent, touchdown, path, retraction, and what to do when an input fails.

use nalgebra::Vector3;
use tangent_estimation::ObjectEstimate;
use tangent_estimation::object_pose::ImplicitSurface;
use tangent_mechanics::{Arm, Base, Flange, JointFriction, Joints, Object, Pose, Tool};
use tangent_sensing::Validity;

use super::estimate_follower::EstimateFollower;
use super::law::{
    ArmNow, Constraint, ForceIntegral, MotionIntegral, MotionReference, hybrid,
    motion_acceleration, pressing_force, stacked, torque,
};
use super::reference::{Descent, ObjectReference, SurfacePath};
use super::{ForceChannel, HybridDynamicsConfig, HybridInput, HybridOutput};
use crate::wrench_guard::{WrenchGuard, WrenchVerdict};
use crate::{ControlError, Fault, Limits, Path, Phase, Profile, Task};

/// The controller. One [`HybridDynamics::step`] per control period; nothing in it allocates.
pub struct HybridDynamics {
    model: Arm<6>,
    flange_from_tool: Pose<Flange, Tool>,
    limits: Limits,
    config: HybridDynamicsConfig,
    friction: JointFriction<6>,
    task: Task,
    path: Path,
    surface: Box<dyn ImplicitSurface>,
    run: Run,
}

/// Memory of one task.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    phase: Phase,
    fault: Option<Fault>,
    since_s: f64,
    /// In this phase, s.
    phase_s: f64,
    guard: WrenchGuard,
    object: Option<EstimateFollower>,
    /// Where the tool is kept while nothing else is wanted.
    held: Option<Pose<Base, Tool>>,
    descent: Option<Descent>,
    lay: Option<SurfacePath>,
    path_s: f64,
    /// Rate of the reference's clock, 0 to 1.
    rate: f64,
    retract: Option<(Vector3<f64>, Profile)>,
    after_retract: Phase,
    motion: MotionIntegral,
    force: ForceIntegral,
    reference_n: f64,
    weak_cycles: u32,
    lost_count: u32,
    sought_m: f64,
    blind_s: f64,
    torque: Joints<6>,
}

/// What one phase wants.
struct Wanted {
    reference: MotionReference,
    /// The same point in object axes, where it was planned there.
    in_object: Option<Vector3<f64>>,
    pressing: bool,
    /// Speed against the normal while seeking, m/s.
    seek_m_per_s: f64,
}

impl HybridDynamics {
    /// For an arm with what it carries, a task, and the object's surface.
    ///
    /// # Errors
    /// A parameter, limit or task out of its range.
    pub fn new(
        model: Arm<6>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: &HybridDynamicsConfig,
        task: &Task,
        surface: Box<dyn ImplicitSurface>,
    ) -> Result<Self, ControlError> {
        limits.check()?;
        config.check()?;
        task.check()?;
        let path = Path::new(
            &task.path,
            config.path.acceleration_m_per_s2,
            config.path.jerk_m_per_s3,
        )?;
        Ok(Self {
            model,
            flange_from_tool,
            limits,
            friction: config.friction.model(),
            config: config.clone(),
            task: task.clone(),
            path,
            surface,
            run: Run {
                phase: Phase::Tare,
                ..Run::default()
            },
        })
    }

    /// Begins the task anew.
    pub fn restart(&mut self) {
        self.run = Run {
            phase: Phase::Tare,
            ..Run::default()
        };
    }

    /// Ends the task: the tool leaves the surface.
    pub fn stop(&mut self) {
        if self.run.phase.is_active() {
            self.leave(Phase::Done);
        }
    }

    /// One control period.
    pub fn step(&mut self, input: &HybridInput) -> HybridOutput {
        let dt = input.dt_s;
        let sound = input.q.iter().chain(input.qd.iter()).all(|x| x.is_finite());
        if !sound {
            return self.blind_output(input);
        }
        let now = ArmNow::new(&self.model, &self.flange_from_tool, &input.q, &input.qd);
        self.run.since_s += dt;
        self.run.phase_s += dt;
        let verdict = self.run.guard.step(
            &self.config.patience,
            input.wrench_validity,
            input.wrench.is_finite(),
            input.wrench_age_s,
            dt,
        );
        let estimate = self.usable(input);
        self.follow(estimate.as_ref(), &now, dt);
        let constraint = self.constraint(&now);
        let (force, moment) = if verdict == WrenchVerdict::Good {
            (
                now.tool.rotate(&input.wrench.force),
                now.tool.rotate(&input.wrench.torque),
            )
        } else {
            (Vector3::zeros(), Vector3::zeros())
        };
        let pressing_n = match self.config.force.channel {
            ForceChannel::Torque => pressing_force(&now, &constraint.normal, &force),
            // The pseudo-inverse lets friction into the force; the normal alone does not.
            ForceChannel::Acceleration => constraint.normal.dot(&force),
        };

        self.judge(input, verdict, &now, estimate.as_ref(), &force, &moment);
        let wanted = self.advance(input, &now, estimate.as_ref(), pressing_n, verdict);

        let motion = motion_acceleration(
            &self.config.motion,
            &mut self.run.motion,
            &now,
            &wanted.reference,
            dt,
        );
        let mut constraint = constraint;
        // While seeking, the surface's own speed is what the damping holds against.
        constraint.velocity -= constraint.normal * wanted.seek_m_per_s;
        let (acceleration, push) = if wanted.pressing {
            let wrench = stacked(&force, &moment);
            let seeking = wanted.seek_m_per_s > 0.0;
            let reference = if seeking || verdict != WrenchVerdict::Good {
                pressing_n
            } else {
                self.run.reference_n
            };
            let mut gains = self.config.force;
            if seeking {
                // The published law has no damping to hold a speed with.
                gains.damping_per_s = self.config.motion.position_damping_per_s;
            }
            let command = hybrid(
                &gains,
                &mut self.run.force,
                &now,
                &constraint,
                &motion,
                reference,
                pressing_n,
                &wrench,
                dt,
            );
            (command.acceleration, command.push)
        } else {
            (motion, Joints::<6>::zeros())
        };
        let twist = stacked(&wanted.reference.velocity, &wanted.reference.angular);
        let (torque, limited) = torque(
            &self.model,
            &self.limits,
            &self.config,
            &self.friction,
            &now,
            &acceleration,
            &twist,
            &push,
        );
        if torque.iter().all(|x| x.is_finite()) {
            self.run.torque = torque;
        }
        let away = now.tool.translation() - wanted.reference.position;
        let n = &constraint.normal;
        HybridOutput {
            torque: self.run.torque,
            phase: self.run.phase,
            fault: self.run.fault,
            tare_requested: self.run.phase == Phase::Tare && self.task.tare,
            in_contact: self.run.phase.is_pressing(),
            contact_lost_count: self.run.lost_count,
            normal: *n,
            force_reference_n: if wanted.pressing {
                self.run.reference_n
            } else {
                0.0
            },
            force_n: pressing_n,
            base_from_tool: now.tool,
            path_reference: wanted.reference.position,
            reference_in_object: wanted.in_object,
            path_error_m: (away - n * n.dot(&away)).norm(),
            path_progress: (self.run.path_s / self.path.duration_s().max(1e-9)).min(1.0),
            alignment_error_rad: n.angle(&-now.tool.z_axis()),
            manipulability: now.jacobian.determinant().abs(),
            limited,
        }
    }

    /// The arm's state is no number: the last torque that held it is the best guess.
    fn blind_output(&mut self, input: &HybridInput) -> HybridOutput {
        self.run.fault = Some(Fault::ArmState);
        self.run.phase = Phase::Fault;
        self.run.held = None;
        HybridOutput {
            torque: self.run.torque,
            phase: Phase::Fault,
            fault: self.run.fault,
            tare_requested: false,
            in_contact: false,
            contact_lost_count: self.run.lost_count,
            normal: Vector3::z(),
            force_reference_n: 0.0,
            force_n: 0.0,
            base_from_tool: Pose::identity(),
            path_reference: Vector3::zeros(),
            reference_in_object: None,
            path_error_m: 0.0,
            path_progress: 0.0,
            alignment_error_rad: 0.0,
            manipulability: 0.0,
            limited: !input.arm_ready,
        }
    }

    /// The estimate if it may be used now.
    fn usable(&self, input: &HybridInput) -> Option<ObjectEstimate> {
        let patience = self.config.patience.estimate_s;
        input.estimate.filter(|e| {
            e.validity.is_valid()
                && input.estimate_age_s <= patience
                && e.base_from_object.matrix().iter().all(|x| x.is_finite())
        })
    }

    /// Takes the estimate over, about the point under the tool.
    fn follow(&mut self, estimate: Option<&ObjectEstimate>, now: &ArmNow, dt: f64) {
        match (&mut self.run.object, estimate) {
            (None, Some(e)) => {
                self.run.object = Some(EstimateFollower::new(e.base_from_object));
            }
            (Some(object), Some(e)) => {
                let pivot = object
                    .pose()
                    .inverse()
                    .transform_point(&now.tool.translation());
                object.step(&self.config.estimate, &e.base_from_object, &pivot, dt);
            }
            (Some(object), None) => object.hold(&self.config.estimate, dt),
            (None, None) => {}
        }
    }

    fn object_from_tool(&self, now: &ArmNow) -> Option<Pose<Object, Tool>> {
        let object = self.run.object.as_ref()?;
        Some(object.pose().inverse() * now.tool)
    }

    fn constraint(&self, now: &ArmNow) -> Constraint {
        let Some(object) = &self.run.object else {
            return Constraint {
                normal: -now.tool.z_axis(),
                hessian: nalgebra::Matrix3::zeros(),
                velocity: Vector3::zeros(),
            };
        };
        let pose = object.pose();
        let tip = pose.inverse().transform_point(&now.tool.translation());
        let rotation = pose.rotation().to_rotation_matrix();
        let size = self.surface.gradient(&tip).norm();
        Constraint {
            normal: rotation * self.surface.normal(&tip),
            hessian: rotation * (self.surface.hessian(&tip) / size) * rotation.transpose(),
            // The pose in use moves for its own reasons; the object itself stands or creeps.
            velocity: Vector3::zeros(),
        }
    }

    /// Everything that ends or stops a task.
    fn judge(
        &mut self,
        input: &HybridInput,
        verdict: WrenchVerdict,
        now: &ArmNow,
        estimate: Option<&ObjectEstimate>,
        force: &Vector3<f64>,
        moment: &Vector3<f64>,
    ) {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return;
        }
        let touching = self.run.phase.is_pressing() || self.run.phase == Phase::Seek;
        self.run.blind_s = if estimate.is_some() {
            0.0
        } else {
            self.run.blind_s + input.dt_s
        };
        let reason = match input.estimate {
            None => Validity::Missing,
            Some(e) if e.validity.is_valid() => Validity::Stale,
            Some(e) => e.validity,
        };
        let at = now.tool.translation();
        let (low, high) = (&self.limits.workspace_min_m, &self.limits.workspace_max_m);
        let outside = (0..3).any(|i| at[i] < low[i] || at[i] > high[i]);
        let begun = self.run.phase != Phase::Tare;
        let task_s = self.task.timeouts.task_s;
        let fault = match verdict {
            WrenchVerdict::Retract(validity) if begun => Some(Fault::Wrench(validity)),
            _ if force.norm() > self.limits.force_max_n => Some(Fault::ForceLimit),
            _ if moment.norm() > self.limits.torque_max_nm => Some(Fault::TorqueLimit),
            _ if outside && begun => Some(Fault::Workspace),
            _ if !input.arm_ready && begun => Some(Fault::ArmNotReady),
            _ if task_s > 0.0 && self.run.since_s > task_s => Some(Fault::TaskTimeout),
            _ if begun && self.run.blind_s > self.config.patience.estimate_retract_s => {
                Some(Fault::Estimate(reason))
            }
            _ if touching && self.run.lost_count > self.config.touch.lost_count_max => {
                Some(Fault::ContactUnstable)
            }
            _ => None,
        };
        if let Some(fault) = fault {
            self.run.fault = Some(fault);
            self.leave(Phase::Fault);
        }
    }

    fn enter(&mut self, phase: Phase) {
        if self.run.phase != phase {
            self.run.phase = phase;
            self.run.phase_s = 0.0;
        }
    }

    fn leave(&mut self, then: Phase) {
        self.run.after_retract = then;
        self.run.retract = None;
        self.run.held = None;
        self.enter(Phase::Retract);
    }

    /// Back to where an interruption found the task.
    fn resume(&mut self) {
        self.run.rate = 0.0;
        self.enter(if self.run.path_s > 0.0 {
            Phase::Slide
        } else {
            Phase::Contact
        });
    }

    fn fail(&mut self, fault: Fault) {
        self.run.fault = Some(fault);
        self.leave(Phase::Fault);
    }

    /// Moves the phases on and says where the tool is wanted.
    fn advance(
        &mut self,
        input: &HybridInput,
        now: &ArmNow,
        estimate: Option<&ObjectEstimate>,
        pressing_n: f64,
        verdict: WrenchVerdict,
    ) -> Wanted {
        let dt = input.dt_s;
        let good = verdict == WrenchVerdict::Good;
        let stopped = matches!(verdict, WrenchVerdict::Stop(_));
        self.keep_time(estimate.is_some() && !stopped, dt);
        match self.run.phase {
            Phase::Tare => {
                let tared = !self.task.tare
                    || input
                        .bias_age_s
                        .is_some_and(|age| age < self.run.since_s - 1e-9);
                if tared && good && input.arm_ready {
                    if let Some(e) = estimate {
                        self.begin_descent(now, e);
                    } else if self.run.phase_s > self.task.timeouts.tare_s {
                        self.fail(Fault::Estimate(
                            input.estimate.map_or(Validity::Missing, |e| e.validity),
                        ));
                    }
                } else if self.run.phase_s > self.task.timeouts.tare_s {
                    self.fail(if input.arm_ready {
                        Fault::NoTare
                    } else {
                        Fault::ArmNotReady
                    });
                }
                self.hold(now)
            }
            Phase::Approach => self.approach(now, pressing_n, good, dt),
            Phase::Contact | Phase::Slide | Phase::Hold | Phase::Seek => {
                if stopped {
                    // Without a wrench there is nothing to control the force with: stand.
                    self.enter(Phase::Hold);
                    return self.hold(now);
                }
                self.run.held = None;
                self.press(now, estimate.is_some(), pressing_n, good, dt)
            }
            Phase::Retract => self.retract(now),
            Phase::Idle | Phase::Done | Phase::Fault => self.hold(now),
        }
    }

    /// The reference's clock slows to a stand while something is missing, and picks up again.
    fn keep_time(&mut self, going: bool, dt: f64) {
        let step = dt / self.config.path.clock_ramp_s.max(dt);
        let change = if going { step } else { -step };
        self.run.rate = (self.run.rate + change).clamp(0.0, 1.0);
    }

    fn hold(&mut self, now: &ArmNow) -> Wanted {
        let pose = *self.run.held.get_or_insert(now.tool);
        Wanted {
            reference: MotionReference::at_rest(&pose),
            in_object: None,
            pressing: false,
            seek_m_per_s: 0.0,
        }
    }

    fn begin_descent(&mut self, now: &ArmNow, estimate: &ObjectEstimate) {
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
            self.task.approach.speed_m_per_s,
            (
                self.config.path.acceleration_m_per_s2,
                self.config.path.jerk_m_per_s3,
            ),
            self.config.estimate.slow_within_sd * sd,
        ));
        self.run.held = None;
        self.run.rate = 0.0;
        self.enter(Phase::Approach);
    }

    fn approach(&mut self, now: &ArmNow, pressing_n: f64, good: bool, dt: f64) -> Wanted {
        let (Some(mut descent), Some(object)) = (self.run.descent, self.run.object) else {
            return self.hold(now);
        };
        let touch = &self.config.touch;
        descent.step(
            self.run.rate,
            touch.seek_speed_m_per_s,
            self.config.path.acceleration_m_per_s2,
            dt,
        );
        self.run.descent = Some(descent);
        let reference = descent.at(self.run.rate);
        if good && pressing_n > touch.on_n {
            self.touch_down(&reference, object.pose(), now, pressing_n);
        } else if descent.beyond_m() > touch.seek_distance_max_m {
            self.fail(Fault::NoSurface);
        }
        Wanted {
            in_object: Some(reference.position),
            reference: reference.in_base(&object),
            pressing: false,
            seek_m_per_s: 0.0,
        }
    }

    fn touch_down(
        &mut self,
        reference: &ObjectReference,
        object: &Pose<Base, Object>,
        now: &ArmNow,
        pressing_n: f64,
    ) {
        let x = object.unrotate(&self.task.plane.x_axis.in_base(&now.tool));
        self.run.lay = Some(SurfacePath::new(
            &*self.surface,
            &reference.position,
            &x,
            &reference.rotation,
        ));
        self.run.path_s = 0.0;
        self.run.reference_n = pressing_n.min(self.task.force.reference_n);
        self.run.force = ForceIntegral::default();
        self.enter(Phase::Contact);
    }

    fn press(&mut self, now: &ArmNow, seen: bool, pressing_n: f64, good: bool, dt: f64) -> Wanted {
        let (Some(lay), Some(object)) = (self.run.lay, self.run.object) else {
            return self.hold(now);
        };
        let touch = self.config.touch;
        self.run.weak_cycles = if good && pressing_n < touch.off_n {
            self.run.weak_cycles + 1
        } else {
            0
        };
        if self.run.phase == Phase::Seek {
            self.run.sought_m += touch.seek_speed_m_per_s * dt;
            if good && pressing_n > touch.on_n {
                self.run.force = ForceIntegral::default();
                self.run.reference_n = pressing_n.min(self.task.force.reference_n);
                self.resume();
            } else if self.run.sought_m > self.limits.blind_distance_max_m {
                self.fail(Fault::SurfaceLost);
            }
        } else if self.run.weak_cycles >= touch.lost_cycles {
            self.run.lost_count += 1;
            self.run.sought_m = 0.0;
            self.enter(Phase::Seek);
        } else {
            let step = self.config.force.reference_rate_n_per_s * dt;
            let wanted = self.task.force.reference_n;
            self.run.reference_n += (wanted - self.run.reference_n).clamp(-step, step);
        }
        self.along_the_path(seen, dt);
        let sliding = self.run.phase == Phase::Slide;
        let rate = if sliding { self.run.rate } else { 0.0 };
        let reference = lay.at(&*self.surface, &self.path, self.run.path_s, rate);
        Wanted {
            in_object: Some(reference.position),
            reference: reference.in_base(&object),
            pressing: true,
            seek_m_per_s: if self.run.phase == Phase::Seek {
                touch.seek_speed_m_per_s
            } else {
                0.0
            },
        }
    }

    /// Settling, sliding, and holding where the path ended or the object is out of sight.
    fn along_the_path(&mut self, seen: bool, dt: f64) {
        let ended = self.run.path_s >= self.path.duration_s();
        match self.run.phase {
            Phase::Contact if self.run.phase_s >= self.config.touch.settle_s => {
                self.run.rate = 0.0;
                self.enter(Phase::Slide);
            }
            Phase::Slide => {
                self.run.path_s += self.run.rate * dt;
                if ended || (!seen && self.run.rate <= 0.0) {
                    self.enter(Phase::Hold);
                }
            }
            Phase::Hold if ended => {
                if self.run.phase_s >= self.task.end.hold_s {
                    self.leave(Phase::Done);
                }
            }
            Phase::Hold if seen => self.resume(),
            _ => {}
        }
    }

    fn retract(&mut self, now: &ArmNow) -> Wanted {
        let constraint = self.constraint(now);
        let pose = *self.run.held.get_or_insert(now.tool);
        let end = &self.task.end;
        let (normal, profile) = *self.run.retract.get_or_insert_with(|| {
            self.run.phase_s = 0.0;
            let profile = Profile::new(
                end.retract_distance_m,
                end.retract_speed_m_per_s,
                self.config.path.acceleration_m_per_s2,
                self.config.path.jerk_m_per_s3,
            );
            (constraint.normal, profile)
        });
        let (way, speed) = profile.at(self.run.phase_s);
        let mut reference = MotionReference::at_rest(&pose);
        reference.position += normal * way;
        reference.velocity = normal * speed;
        if self.run.phase_s > profile.duration_s() + 0.1 {
            let then = self.run.after_retract;
            self.run.held = None;
            self.enter(then);
        }
        Wanted {
            reference,
            in_object: None,
            pressing: false,
            seek_m_per_s: 0.0,
        }
    }
}
