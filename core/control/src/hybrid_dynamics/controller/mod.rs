//! The law in its period: what is felt and seen, what ends a task, which torques follow. The phases themselves are in
//! `phase_steps`.

mod phase_steps;

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
use super::reference::{Descent, SurfacePath};
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
    paused: bool,
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
            paused: false,
            run: Run {
                phase: Phase::Tare,
                ..Run::default()
            },
        })
    }

    /// Begins the task anew.
    pub fn restart(&mut self) {
        self.paused = false;
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

    /// Stops the path where it is, keeps the force; false resumes. Refused where there is no path to stop.
    ///
    /// # Errors
    /// When no task runs, or it is leaving the surface.
    pub fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return Err(ControlError::WrongPhase {
                request: if paused { "pause" } else { "resume" },
                phase: self.run.phase.name(),
                remedy: "start the task again",
            });
        }
        self.paused = paused;
        Ok(())
    }

    /// Pressing force asked for from now on, N; the reference goes there at its rate.
    pub fn set_force_reference(&mut self, force_n: f64) {
        if force_n.is_finite() {
            self.task.force.reference_n = force_n.max(0.0);
        }
    }

    /// Phase after the last step.
    pub fn phase(&self) -> Phase {
        self.run.phase
    }

    /// The task.
    pub fn task(&self) -> &Task {
        &self.task
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
            self.run.motion.forget_along(&constraint.normal);
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
}
