//! One control period of the law: evaluation of the inputs, the conditions that end a task, and the
//! resulting torques. The phases are in `phase_steps`.

mod leaving;
mod phase_steps;

use nalgebra::Vector3;
use tangent_estimation::ObjectEstimate;
use tangent_estimation::object_pose::ImplicitSurface;
use tangent_mechanics::{Arm, Base, Flange, JointFriction, Joints, Object, Pose, Tool};
use tangent_sensing::Validity;

use super::estimate_follower::EstimateFollower;
use super::joint_guard::bounded_torque;
use super::law::{
    ArmNow, Constraint, ForceIntegral, MotionIntegral, MotionReference, hybrid,
    motion_acceleration, pressing_force, stacked, torque,
};
use super::reference::{Descent, SurfacePath};
use super::{ForceChannel, HybridDynamicsConfig, HybridInput, HybridOutput};
use crate::departure::Departure;
use crate::interface::{is_arm_state, is_place, is_time, is_wrench};
use crate::response_guard::{Doing, ResponseGuard, Touch};
use crate::wrench_guard::{WrenchGuard, WrenchVerdict};
use crate::{Clearance, ControlError, Fault, Limits, Path, Phase, Task};

/// Time constant with which the torques fade to gravity compensation after the arm's state becomes
/// invalid, s.
const FADE_S: f64 = 0.025;

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

/// State of one task; reset when a task begins.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    phase: Phase,
    fault: Option<Fault>,
    since_s: f64,
    /// Part of `since_s` that was spent paused, s.
    paused_s: f64,
    /// Time in the current phase without pauses, s.
    phase_s: f64,
    guard: WrenchGuard,
    response: ResponseGuard,
    departure: Departure,
    /// Position of the tool at which the zero in force was taken, base axes, m; `None` after
    /// contact.
    tared_at: Option<Vector3<f64>>,
    /// Whether the zero in force turned out to have been taken in contact.
    zero_withdrawn: bool,
    /// The last usable wrench, base axes.
    felt: Option<Felt>,
    object: Option<EstimateFollower>,
    /// Pose that the tool holds while no motion is commanded.
    held: Option<Pose<Base, Tool>>,
    descent: Option<Descent>,
    lay: Option<SurfacePath>,
    path_s: f64,
    /// Rate of the reference's clock relative to real time, 0 to 1.
    rate: f64,
    motion: MotionIntegral,
    force: ForceIntegral,
    reference_n: f64,
    weak_cycles: u32,
    lost_count: u32,
    sought_m: f64,
    blind_s: f64,
    torque: Joints<6>,
    /// Joint positions, rad, and period, s, of the last cycle with a valid arm state.
    last_good: Option<(Joints<6>, f64)>,
}

/// Wrench at the tool's origin, base axes, N and Nm, and its pressing component, N.
#[derive(Clone, Copy, Debug)]
struct Felt {
    force: Vector3<f64>,
    moment: Vector3<f64>,
    pressing_n: f64,
}

/// Reference of one phase for one period.
struct Wanted {
    reference: MotionReference,
    /// Position of the reference in object axes, m; `None` if it was not planned on the object.
    in_object: Option<Vector3<f64>>,
    pressing: bool,
    /// Speed against the normal while seeking contact, m/s; `None` in other phases.
    seek_m_per_s: Option<f64>,
}

impl HybridDynamics {
    /// Controller for an arm with its payload, a task, and the surface of the object.
    ///
    /// # Errors
    /// A parameter, limit or task is out of its range.
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

    /// Restarts the task with the current clearance.
    pub fn restart(&mut self) {
        self.begin(self.run.departure.clearance);
    }

    /// Begins the task with `clearance`. Unless the tool is known to hang free, it first moves off
    /// the surface (phase `Clear`).
    pub fn begin(&mut self, clearance: Clearance) {
        self.paused = false;
        self.run = Run {
            phase: if clearance.is_free() {
                self.task.phase_at_rest()
            } else {
                Phase::Clear
            },
            departure: Departure::new(clearance),
            ..Run::default()
        };
    }

    /// Whether the tool may touch something. The next start depends on it.
    pub fn clearance(&self) -> Clearance {
        self.run.departure.clearance
    }

    /// Whether a task may start with the tool at `position` (base axes, m) after what is known of
    /// it.
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] if the tool may touch something and the direction away from it is
    /// not known.
    pub fn check_start(
        &self,
        clearance: &Clearance,
        position: &Vector3<f64>,
    ) -> Result<(), ControlError> {
        clearance.way_out(&self.config.leave, position).map(drop)
    }

    /// Ends the task: the tool retracts from the surface.
    pub fn stop(&mut self) {
        if self.run.phase.is_active() {
            self.leave(Phase::Done);
        }
    }

    /// Ends the task with a retraction along `away` (base axes) in place of the last good normal:
    /// for tests of what a wrong one does.
    #[doc(hidden)]
    pub fn stop_along(&mut self, away: Vector3<f64>) {
        self.run.departure.way_off = Some(away);
        self.stop();
    }

    /// Stands still in every phase: the path stops where it is, what presses keeps its force; false
    /// resumes.
    ///
    /// # Errors
    /// No task runs, or it is retracting.
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

    /// Whether the task has ended with the tool possibly still on the surface.
    pub fn is_left_on_surface(&self) -> bool {
        !self.run.phase.is_active()
            && self.run.lay.is_some()
            && self.run.departure.may_be_on_surface()
    }

    /// Retracts a tool that [is left on the surface](Self::is_left_on_surface), by the retraction
    /// distance of the task.
    pub fn leave_surface(&mut self) {
        if !self.is_left_on_surface() {
            return;
        }
        // The arm may have been moved since the task ended: no integral of it is kept.
        self.paused = false;
        self.run.motion = MotionIntegral::default();
        self.run.force = ForceIntegral::default();
        let ended = if self.run.fault.is_some() {
            Phase::Fault
        } else {
            Phase::Done
        };
        self.leave(ended);
    }

    /// Whether the task is paused.
    pub fn is_paused(&self) -> bool {
        self.paused && self.run.phase.is_active() && self.run.phase != Phase::Retract
    }

    /// Sets the desired pressing force, N. The reference moves there at its limited rate.
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

    /// Runs one control period.
    pub fn step(&mut self, input: &HybridInput) -> HybridOutput {
        let dt = input.dt_s;
        if !is_time(input.time_s, dt) || !is_arm_state(&input.q, &input.qd) {
            return self.blind_output(input);
        }
        self.run.last_good = Some((input.q, dt));
        let now = ArmNow::new(&self.model, &self.flange_from_tool, &input.q, &input.qd);
        self.run.since_s += dt;
        // No time limit runs while the task is paused.
        if self.paused && self.run.phase != Phase::Retract {
            self.run.paused_s += dt;
        } else {
            self.run.phase_s += dt;
        }
        let estimate = self.usable(input);
        self.follow(estimate.as_ref(), &now, dt);
        let constraint = self.constraint(&now);
        let validity = self.answering(input, &now, &constraint.normal);
        let verdict = self.run.guard.step(
            &self.config.patience,
            validity,
            is_wrench(&input.wrench),
            input.wrench_age_s,
            dt,
        );
        let felt = (verdict == WrenchVerdict::Good).then(|| {
            let force = now.tool.rotate(&input.wrench.force);
            Felt {
                force,
                moment: now.tool.rotate(&input.wrench.torque),
                pressing_n: match self.config.force.channel {
                    ForceChannel::Torque => pressing_force(&now, &constraint.normal, &force),
                    // Computed with the pseudo-inverse, the force would contain friction; along the
                    // normal it does not.
                    ForceChannel::Acceleration => constraint.normal.dot(&force),
                },
            }
        });
        self.run.felt = felt.or(self.run.felt);

        self.judge(input, verdict, &now, estimate.as_ref(), felt.as_ref());
        let wanted = self.advance(input, &now, estimate.as_ref(), felt.as_ref(), verdict);
        let position = now.tool.translation();
        self.run
            .departure
            .remember(self.run.phase, constraint.normal, position);

        let motion = motion_acceleration(
            &self.config.motion,
            &mut self.run.motion,
            &now,
            &wanted.reference,
            dt,
        );
        let mut constraint = constraint;
        // While seeking, the damping acts relative to the seek speed along the normal.
        constraint.velocity -= constraint.normal * wanted.seek_m_per_s.unwrap_or(0.0);
        // While the wrench is bad, the last good one is used.
        let (acceleration, push) = if let (true, Some(used)) = (wanted.pressing, self.run.felt) {
            self.run.motion.forget_along(&constraint.normal);
            let wrench = stacked(&used.force, &used.moment);
            let pressing_n = used.pressing_n;
            let seeking = wanted.seek_m_per_s.is_some();
            let reference = if seeking || verdict != WrenchVerdict::Good {
                pressing_n
            } else {
                self.run.reference_n
            };
            let mut gains = self.config.force;
            if seeking {
                // The published law has no damping with which to hold a speed.
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
        if !torque.iter().all(|x| x.is_finite()) {
            return self.blind_output(input);
        }
        self.run.torque = torque;
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
            force_n: felt.map(|felt| felt.pressing_n),
            clearance: self.run.departure.clearance,
            zero_withdrawn: self.run.zero_withdrawn,
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

    /// Output for a period in which the arm's state or the period is invalid, or in which the
    /// torques would not be finite. The torques fade to gravity compensation at the last valid
    /// joint positions.
    fn blind_output(&mut self, input: &HybridInput) -> HybridOutput {
        self.run.fault = Some(Fault::ArmState);
        self.run.phase = Phase::Fault;
        self.run.held = None;
        if let Some((q, dt)) = self.run.last_good {
            let gravity = self.model.gravity(&q);
            let held = bounded_torque(self.model.limits(), &gravity, &Joints::zeros()).0;
            self.run.torque += (held - self.run.torque) * (dt / FADE_S).min(1.0);
        }
        HybridOutput {
            torque: self.run.torque,
            phase: Phase::Fault,
            fault: self.run.fault,
            tare_requested: false,
            in_contact: false,
            contact_lost_count: self.run.lost_count,
            normal: Vector3::z(),
            force_reference_n: 0.0,
            force_n: None,
            clearance: self.run.departure.clearance,
            zero_withdrawn: self.run.zero_withdrawn,
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

    /// Validity of the wrench: as the input states it, or by how the wrench responds to the tool's
    /// motion.
    fn answering(&mut self, input: &HybridInput, now: &ArmNow, normal: &Vector3<f64>) -> Validity {
        if !input.wrench_validity.is_valid() {
            return input.wrench_validity;
        }
        self.run.response.step(&Touch {
            doing: Doing::of(self.run.phase),
            position: now.tool.translation(),
            normal: *normal,
            wrench: input.wrench.vector(),
            force_n: now.tool.rotate(&input.wrench.force).dot(normal),
            reference_n: self.task.force.reference_n,
            stiffness_n_per_m: None,
            rests: true,
            fresh: input.wrench_age_s <= input.dt_s,
            depth: None,
            dt_s: input.dt_s,
        })
    }

    /// The estimate, if it can be used in this period.
    fn usable(&self, input: &HybridInput) -> Option<ObjectEstimate> {
        let patience = self.config.patience.estimate_s;
        input.estimate.filter(|e| {
            e.validity.is_valid()
                && input.estimate_age_s <= patience
                && is_place(&e.base_from_object)
                && e.covariance.iter().all(|x| x.is_finite())
        })
    }

    /// Moves the pose in use towards the estimate, with the tool's origin as the pivot.
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
            // The pose in use moves because the estimate changes. The object itself is at rest, or
            // nearly.
            velocity: Vector3::zeros(),
        }
    }

    /// Checks all conditions under which a task ends with a fault.
    fn judge(
        &mut self,
        input: &HybridInput,
        verdict: WrenchVerdict,
        now: &ArmNow,
        estimate: Option<&ObjectEstimate>,
        felt: Option<&Felt>,
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
        let begun = !matches!(self.run.phase, Phase::Tare | Phase::Clear);
        let beyond = |size: fn(&Felt) -> f64, most: f64| felt.is_some_and(|f| size(f) > most);
        let hidden = |load| self.limits.is_untared_beyond(load);
        let untared = felt.and(input.untared.as_ref());
        let zero_lost = self.task.tare && felt.is_some() && input.bias_age_s.is_none();
        let is_old = |most_n| input.zero_bound_n.is_none_or(|bound_n| bound_n > most_n);
        let sliding = matches!(self.run.phase, Phase::Slide | Phase::Hold);
        let task_s = self.task.timeouts.task_s;
        let fault = match verdict {
            WrenchVerdict::Retract(validity) if begun => Some(Fault::Wrench(validity)),
            _ if begun && beyond(|f| f.force.norm(), self.limits.force_max_n) => {
                Some(Fault::ForceLimit)
            }
            _ if begun && beyond(|f| f.moment.norm(), self.limits.torque_max_nm) => {
                Some(Fault::TorqueLimit)
            }
            _ if begun && untared.is_some_and(hidden) => Some(Fault::UntaredLimit),
            _ if begun && zero_lost => Some(Fault::ZeroLost),
            _ if sliding && self.task.zero.error_max_n.is_some_and(is_old) => Some(Fault::ZeroOld),
            _ if outside && begun => Some(Fault::Workspace),
            _ if !input.arm_ready && self.run.phase != Phase::Tare => Some(Fault::ArmNotReady),
            _ if task_s > 0.0 && self.run.since_s - self.run.paused_s > task_s => {
                Some(Fault::TaskTimeout)
            }
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

    /// Retracts from the surface, then enters phase `then`. Enters it at once from `Tare`, before
    /// the tool has approached, and from `Clear`, which moves it off already.
    fn leave(&mut self, then: Phase) {
        if matches!(self.run.phase, Phase::Tare | Phase::Clear) {
            self.run.held = None;
            return self.enter(then);
        }
        self.run.departure.begin_retraction(then);
        self.run.held = None;
        self.enter(Phase::Retract);
    }

    /// Returns to the phase that was interrupted: `Slide` once the path has begun, else `Contact`.
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
