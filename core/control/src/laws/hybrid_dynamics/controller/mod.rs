//! One control period of the law: evaluation of the inputs, the conditions that end a task, and the
//! resulting torques. The phases are in `phase_steps`.

mod as_law;
mod leaving;
mod phase_steps;
mod senses;

use nalgebra::Vector3;
use tangent_estimation::object_pose::ImplicitSurface;
use tangent_mechanics::{Arm, Base, Flange, JointFriction, Joints, Pose, Tool};

use super::estimate_follower::EstimateFollower;
use super::joint_disturbance::JointDisturbance;
use super::law::{
    ArmNow, ForceIntegral, MotionIntegral, MotionReference, friction_torque, hybrid,
    manipulability, motion_acceleration, pressing_force, torque,
};
use super::reference::{Descent, Exploration, SurfacePath};
use super::{ForceChannel, HybridDynamicsConfig, HybridInput, HybridOutput};
use crate::error::ControlError;
use crate::laws::stacked::stacked;
use crate::laws::torque_task::{IDLE_FORCE_N, TorqueTask};
use crate::leaving::clearance::Clearance;
use crate::limits::Limits;
use crate::limits::arm_force::ArmForceGuard;
use crate::limits::faults::Fault;
use crate::limits::joint_guard::bounded_torque;
use crate::limits::motor_force::MotorForce;
use crate::limits::plausibility::{is_arm_state, is_time, is_wrench};
use crate::limits::response_guard::ResponseGuard;
use crate::limits::wrench_guard::{WrenchGuard, WrenchVerdict};
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::Program;

/// Time constant with which the torques fade to gravity compensation after the arm's state becomes
/// invalid, s.
const FADE_S: f64 = 0.025;

/// Time constant with which the compensation of missed friction begins and ends, s.
const MISSED_S: f64 = 0.05;

/// The controller of an arm with `N` joints, at least six. One [`HybridDynamics::step`] per control
/// period; nothing in it allocates.
pub struct HybridDynamics<const N: usize = 6> {
    model: Arm<N>,
    flange_from_tool: Pose<Flange, Tool>,
    limits: Limits,
    /// Joint friction that the law compensates.
    friction: JointFriction<N>,
    task: TorqueTask<HybridDynamicsConfig>,
    surface: Box<dyn ImplicitSurface>,
    run: Run<N>,
}

/// State of one task; reset when a task begins.
#[derive(Clone, Copy, Debug)]
struct Run<const N: usize> {
    guard: WrenchGuard,
    response: ResponseGuard,
    arm_force: ArmForceGuard,
    motor_force: MotorForce<N>,
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
    /// The circle that shows the surface's orientation, once it has begun.
    exploration: Option<Exploration>,
    path_s: f64,
    /// Rate of the reference's clock relative to real time, 0 to 1.
    rate: f64,
    motion: MotionIntegral,
    force: ForceIntegral,
    disturbance: JointDisturbance<N>,
    /// Share of the missed friction that is compensated: 1 while pressing, else 0.
    missed_share: f64,
    reference_n: f64,
    /// Time for which the force has been too low for contact, s.
    weak_s: f64,
    lost_count: u32,
    sought_m: f64,
    blind_s: f64,
    torque: Joints<N>,
    /// Joint positions, rad, and period, s, of the last cycle with a valid arm state.
    last_good: Option<(Joints<N>, f64)>,
}

impl<const N: usize> Run<N> {
    fn new() -> Self {
        Self {
            guard: WrenchGuard::default(),
            response: ResponseGuard::default(),
            arm_force: ArmForceGuard::default(),
            motor_force: MotorForce::default(),
            tared_at: None,
            zero_withdrawn: false,
            felt: None,
            object: None,
            held: None,
            descent: None,
            lay: None,
            exploration: None,
            path_s: 0.0,
            rate: 0.0,
            motion: MotionIntegral::default(),
            force: ForceIntegral::default(),
            disturbance: JointDisturbance::default(),
            missed_share: 0.0,
            reference_n: 0.0,
            weak_s: 0.0,
            lost_count: 0,
            sought_m: 0.0,
            blind_s: 0.0,
            torque: Joints::zeros(),
            last_good: None,
        }
    }
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

impl<const N: usize> HybridDynamics<N> {
    /// Controller for an arm with its payload, a task, and the surface of the object.
    ///
    /// # Errors
    /// A parameter, limit or task is out of its range.
    pub fn new(
        model: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: &HybridDynamicsConfig,
        task: &Task,
        surface: Box<dyn ImplicitSurface>,
    ) -> Result<Self, ControlError> {
        let program = Program::with_config(task, config.clone())?;
        let task = TorqueTask::new(program);
        Self::with_task(model, flange_from_tool, limits, task, surface)
    }

    /// Controller for an arm with its payload and the surface of the object, before the first task.
    /// `clearance` is what is known of the tool.
    ///
    /// # Errors
    /// A parameter or limit is out of its range.
    pub fn idle(
        model: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: &HybridDynamicsConfig,
        surface: Box<dyn ImplicitSurface>,
        clearance: Clearance,
    ) -> Result<Self, ControlError> {
        let program = Program::with_config(&Task::leave(IDLE_FORCE_N), config.clone())?;
        let task = TorqueTask::idle(program, clearance);
        Self::with_task(model, flange_from_tool, limits, task, surface)
    }

    fn with_task(
        model: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        task: TorqueTask<HybridDynamicsConfig>,
        surface: Box<dyn ImplicitSurface>,
    ) -> Result<Self, ControlError> {
        limits.check()?;
        Ok(Self {
            model,
            flange_from_tool,
            limits,
            friction: task.program.config.friction.model(),
            task,
            surface,
            run: Run::new(),
        })
    }

    /// Runs one control period.
    pub fn step(&mut self, input: &HybridInput<N>) -> HybridOutput<N> {
        let output = self.period(input);
        self.task.keep_normal(output.phase, output.normal);
        output
    }

    fn period(&mut self, input: &HybridInput<N>) -> HybridOutput<N> {
        let dt = input.dt_s;
        if !is_time(input.time_s, dt) || !is_arm_state(&input.q, &input.qd) {
            return self.blind_output(input);
        }
        self.run.last_good = Some((input.q, dt));
        let now = ArmNow::new(&self.model, &self.flange_from_tool, &input.q, &input.qd);
        self.task.count(dt);
        let estimate = self.usable(input);
        self.follow(estimate.as_ref(), &now, dt);
        let constraint = self.constraint(&now);
        let validity = self.answering(input, &now, &constraint.normal);
        let verdict = self.run.guard.step(
            &self.task.program.config.patience,
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
                pressing_n: match self.task.program.config.force.channel {
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
        self.task
            .departure
            .remember(self.task.phase, constraint.normal, position);

        let motion = motion_acceleration(
            &self.task.program.config.motion,
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
            let mut gains = self.task.program.config.force;
            if seeking {
                // The published law has no damping with which to hold a speed.
                gains.damping_per_s = self.task.program.config.motion.position_damping_per_s;
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
            (motion, Joints::<N>::zeros())
        };
        let twist = stacked(&wanted.reference.velocity, &wanted.reference.angular);
        let config = &self.task.program.config;
        let modelled = friction_torque(&self.limits, config, &self.friction, &now, &twist);
        let rubbed = modelled + self.missed(input, &now, dt);
        let config = &self.task.program.config;
        let (torque, limited) = torque(
            &self.model,
            &self.limits,
            config,
            &now,
            &acceleration,
            &rubbed,
            &push,
        );
        if !torque.iter().all(|x| x.is_finite()) {
            return self.blind_output(input);
        }
        self.run.torque = torque;
        self.run.disturbance.commanded(&torque, &modelled);
        (self.run.motor_force).commanded(input.arm_ready.then_some(torque));
        let away = now.tool.translation() - wanted.reference.position;
        let n = &constraint.normal;
        HybridOutput {
            torque: self.run.torque,
            phase: self.task.phase,
            fault: self.task.fault,
            tare_requested: self.task.phase == Phase::Tare && self.task.program.task.tare,
            in_contact: self.task.phase.is_pressing(),
            contact_lost_count: self.run.lost_count,
            normal: *n,
            force_reference_n: if wanted.pressing {
                self.run.reference_n
            } else {
                0.0
            },
            force_n: felt.map(|felt| felt.pressing_n),
            clearance: self.task.departure.clearance,
            zero_withdrawn: self.run.zero_withdrawn,
            base_from_tool: now.tool,
            path_reference: wanted.reference.position,
            reference_in_object: wanted.in_object,
            path_error_m: (away - n * n.dot(&away)).norm(),
            path_progress: (self.run.path_s / self.task.program.path.duration_s().max(1e-9))
                .min(1.0),
            alignment_error_rad: n.angle(&-now.tool.z_axis()),
            manipulability: manipulability(&now.jacobian),
            limited,
        }
    }

    /// Friction that its model misses, Nm, while the tool presses: there the force depends on it. A
    /// motion in the air has to be as even as its reference, so that an unsteady force means
    /// contact, and stiction that is cancelled at rest would make the arm creep. Without torques
    /// that the arm takes, or without a tared wrench, nothing can be told of it, and the estimate
    /// starts again.
    fn missed(&mut self, input: &HybridInput<N>, now: &ArmNow<N>, dt: f64) -> Joints<N> {
        let tared = input.bias_age_s.is_some();
        let (true, Some(felt)) = (input.arm_ready && tared, self.run.felt) else {
            self.run.disturbance = JointDisturbance::default();
            return Joints::zeros();
        };
        let contact = now.jacobian.tr_mul(&stacked(&felt.force, &felt.moment));
        let pressing = self.task.phase.is_pressing() && !self.task.paused;
        let wanted = if pressing { 1.0 } else { 0.0 };
        self.run.missed_share += (wanted - self.run.missed_share) * (dt / MISSED_S).min(1.0);
        let missed = self.run.disturbance.step(
            &self.task.program.config.friction_doubt,
            now.dynamics,
            &self.friction,
            &now.qd,
            &contact,
            dt,
        );
        missed * self.run.missed_share
    }

    /// Output for a period in which the arm's state or the period is invalid, or in which the
    /// torques would not be finite. The torques fade to gravity compensation at the last valid
    /// joint positions.
    fn blind_output(&mut self, input: &HybridInput<N>) -> HybridOutput<N> {
        self.task.fault = Some(Fault::ArmState);
        self.task.phase = Phase::Fault;
        self.run.held = None;
        if let Some((q, dt)) = self.run.last_good {
            let gravity = self.model.gravity(&q);
            let held = bounded_torque(self.model.limits(), &gravity, &Joints::zeros()).0;
            self.run.torque += (held - self.run.torque) * (dt / FADE_S).min(1.0);
        }
        HybridOutput {
            torque: self.run.torque,
            phase: Phase::Fault,
            fault: self.task.fault,
            tare_requested: false,
            in_contact: false,
            contact_lost_count: self.run.lost_count,
            normal: Vector3::z(),
            force_reference_n: 0.0,
            force_n: None,
            clearance: self.task.departure.clearance,
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

    /// Returns to the phase that was interrupted: `Slide` once the path has begun, else `Contact`.
    fn resume(&mut self) {
        self.run.rate = 0.0;
        self.task.enter(if self.run.path_s > 0.0 {
            Phase::Slide
        } else {
            Phase::Contact
        });
    }
}
