//! One control period of the law: from the measurements to the torques. The evaluation of the
//! measurements is in `senses`, the phases are in `phase_steps`, and the composition of the torques
//! is in `torques`.

mod as_law;
mod leaving;
mod phase_steps;
mod run;
mod senses;
mod torques;

use nalgebra::{Matrix3, Vector3, Vector6};
use tangent_mechanics::{Arm, Flange, JointFriction, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use run::Run;

use super::config::UnifiedForceImpedanceConfig;
use super::energy::DELAY_MAX;
use super::interface::{TorqueInterface, UnifiedInput, UnifiedOutput};
use super::law::{ArmNow, MotionReference, pose_error};
use super::orientation::OrientationReference;
use crate::error::{ControlError, check_range};
use crate::laws::stacked::stacked;
use crate::laws::torque_task::{IDLE_FORCE_N, TorqueTask};
use crate::leaving::clearance::Clearance;
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::limits::plausibility::{is_arm_state, is_time};
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::Program;

/// Time constant with which the torques fade to gravity compensation after the arm's state becomes
/// invalid, s.
const FADE_S: f64 = 0.025;

/// The controller of an arm with `N` joints, at least six. One [`UnifiedForceImpedance::step`] per
/// control period; nothing in it allocates.
pub struct UnifiedForceImpedance<const N: usize = 7> {
    model: Arm<N>,
    flange_from_tool: Pose<Flange, Tool>,
    limits: Limits,
    /// Joint friction that the law compensates.
    friction: JointFriction<N>,
    task: TorqueTask<UnifiedForceImpedanceConfig>,
    interface: TorqueInterface,
    run: Run<N>,
}

/// Measured contact quantities of one period.
#[derive(Clone, Copy, Debug)]
struct Felt {
    verdict: WrenchVerdict,
    /// Wrench, tool axes; `None` if none can be used. During an invalid sample it is the last valid
    /// one.
    wrench: Option<Vector6<f64>>,
    /// Pressing force along the direction of the push, N.
    pressing_n: Option<f64>,
    /// Whether a valid untared reading is beyond its limit.
    hidden: bool,
}

impl Felt {
    /// Pressing force from a wrench of this period, N; `None` without one.
    fn pressing_now_n(&self) -> Option<f64> {
        self.pressing_n
            .filter(|_| self.verdict == WrenchVerdict::Good)
    }
}

/// Reference of one phase.
#[derive(Clone, Copy, Debug)]
struct Wanted {
    reference: MotionReference,
    /// Position of the policy, m.
    policy: Vector3<f64>,
    pressing: bool,
}

impl<const N: usize> UnifiedForceImpedance<N> {
    /// Controller for an arm with its payload, a torque interface, and a task.
    ///
    /// # Errors
    /// A parameter, limit or task is out of its range.
    pub fn new(
        model: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: &UnifiedForceImpedanceConfig,
        task: &Task,
        interface: TorqueInterface,
    ) -> Result<Self, ControlError> {
        let program = Program::with_config(task, config.clone())?;
        let task = TorqueTask::new(program);
        Self::with_task(model, flange_from_tool, limits, task, interface)
    }

    /// Controller for an arm with its payload and a torque interface, before the first task.
    /// `clearance` is what is known of the tool.
    ///
    /// # Errors
    /// A parameter or limit is out of its range.
    pub fn idle(
        model: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: &UnifiedForceImpedanceConfig,
        interface: TorqueInterface,
        clearance: Clearance,
    ) -> Result<Self, ControlError> {
        let program = Program::with_config(&Task::leave(IDLE_FORCE_N), config.clone())?;
        let task = TorqueTask::idle(program, clearance);
        Self::with_task(model, flange_from_tool, limits, task, interface)
    }

    fn with_task(
        model: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        task: TorqueTask<UnifiedForceImpedanceConfig>,
        interface: TorqueInterface,
    ) -> Result<Self, ControlError> {
        limits.check()?;
        let delay = interface.delay_periods as f64;
        check_range("delay_periods", delay, 0.0, DELAY_MAX as f64)?;
        check_range("effort_share", interface.effort_share, 0.01, 1.0)?;
        check_range("rate_share", interface.rate_share, 0.01, 1.0)?;
        let run = Run::new(&task.program.config);
        Ok(Self {
            model,
            flange_from_tool,
            limits,
            friction: friction(&task.program.config),
            task,
            interface,
            run,
        })
    }

    /// Runs one control period.
    pub fn step(&mut self, input: &UnifiedInput<N>) -> UnifiedOutput<N> {
        let output = self.period(input);
        self.task.keep_normal(output.phase, output.normal);
        output
    }

    fn period(&mut self, input: &UnifiedInput<N>) -> UnifiedOutput<N> {
        let dt = input.dt_s;
        if !is_time(input.time_s, dt) || !is_arm_state(&input.q, &input.qd) {
            return self.blind_output();
        }
        self.run.period_s = dt;
        let now = ArmNow::new(&self.model, &self.flange_from_tool, &input.q, &input.qd);
        self.task.count(dt);
        self.run.tanks.settle(
            &self.task.program.config.tanks,
            &input.q,
            self.interface.delay_periods,
        );
        self.run.fused.calibrate(
            &self.task.program.config.fusion,
            input.time_s,
            &now.tool,
            self.task.phase.is_pressing(),
            dt,
        );
        let normal = self.run.fused.step(
            &self.task.program.config.fusion,
            input.time_s,
            &now.tool.translation(),
            &now.tool.z_axis(),
            input.vision.as_ref(),
            input.touch.as_ref().map(|t| (t, input.touch_age_s)),
            dt,
        );
        let felt = self.feel(input, &now);
        self.judge(input, &felt, &now, &normal);
        let wanted = self.advance(input, &now, &normal, &felt);
        let (away, position) = (self.smooth_normal(&now), now.tool.translation());
        self.task
            .departure
            .remember(self.task.phase, away, position);
        let error = pose_error(&now, &wanted.reference);
        let rho_force = self.watch(&wanted, &now, &normal, &felt, &error, dt);
        let (torque, force_reference_n) = self.torques(&wanted, &now, &felt, &error, rho_force, dt);
        let by_arm = if self.interface.gravity_by_arm {
            now.gravity
        } else {
            Joints::zeros()
        };
        (self.run.motor_force).commanded(input.arm_ready.then_some(torque + by_arm));
        if self.run.lost {
            self.run.lost = false;
            return self.blind_output();
        }
        let away = now.tool.translation() - wanted.policy;
        let n = &normal.normal;
        UnifiedOutput {
            torque,
            held_torque: self.run.held_torque,
            phase: self.task.phase,
            fault: self.task.fault,
            in_contact: self.touches(),
            contact_lost_count: self.run.lost_count,
            normal: *n,
            normal_covariance: normal.covariance,
            normal_validity: normal.validity,
            wrench: felt.wrench.map(|wrench| Wrench::from_vector(&wrench)),
            clearance: self.task.departure.clearance,
            zero_age_s: self.zero_age_s(),
            zero_bound_n: self.zero_bound_n(),
            force_reference_n,
            force_n: felt.pressing_n,
            base_from_tool: now.tool,
            path_reference: wanted.policy,
            path_error_m: (away - n * n.dot(&away)).norm(),
            path_progress: (self.run.path_s / self.task.program.path.duration_s().max(1e-9))
                .min(1.0),
            alignment_error_rad: n.angle(&-now.tool.z_axis()),
            monitor: self.run.monitor.value,
            monitor_margin: self.run.monitor.margin(&self.task.program.config.monitor),
            rho_align: self.run.monitor.rho,
            rho_force,
            tanks: self.run.tanks.books(),
            friction: self.run.surface_friction,
            manipulability: now.manipulability(),
            limited: self.run.limited,
        }
    }

    /// Output for a period in which the arm's state or the period is invalid, or in which the
    /// torques would not be finite. The last torques against gravity are kept, and the other
    /// torques fade out.
    fn blind_output(&mut self) -> UnifiedOutput<N> {
        self.task.fault = Some(Fault::ArmState);
        self.task.enter(Phase::Fault);
        self.run.held = None;
        let held = self.run.held_torque;
        let share = (self.run.period_s / FADE_S).min(1.0);
        let last = self.run.torque.unwrap_or(held);
        let torque = last + (held - last) * share;
        self.run.torque = Some(torque);
        // The accounts include the torques in effect in every period, this one too.
        let fading = self.run.tanks.committed() * (1.0 - share);
        self.run.tanks.commit(fading);
        UnifiedOutput {
            torque,
            held_torque: held,
            phase: Phase::Fault,
            fault: self.task.fault,
            in_contact: false,
            contact_lost_count: self.run.lost_count,
            normal: Vector3::z(),
            normal_covariance: Matrix3::identity(),
            normal_validity: Validity::Missing,
            wrench: None,
            clearance: self.task.departure.clearance,
            zero_age_s: self.zero_age_s(),
            zero_bound_n: self.zero_bound_n(),
            force_reference_n: 0.0,
            force_n: None,
            base_from_tool: Pose::identity(),
            path_reference: Vector3::zeros(),
            path_error_m: 0.0,
            path_progress: 0.0,
            alignment_error_rad: 0.0,
            monitor: 0.0,
            monitor_margin: 0.0,
            rho_align: 0.0,
            rho_force: 0.0,
            tanks: self.run.tanks.books(),
            friction: 0.0,
            manipulability: 0.0,
            limited: true,
        }
    }

    /// Direction of the push, base axes: the tool's z axis as published, or against the normal.
    fn push_direction(&self, now: &ArmNow<N>) -> Vector3<f64> {
        if self.task.program.config.force.along_normal {
            -self.smooth_normal(now)
        } else {
            now.tool.z_axis()
        }
    }

    /// The normal to which the tool is being turned: without the jumps caused by frames.
    fn smooth_normal(&self, now: &ArmNow<N>) -> Vector3<f64> {
        self.run
            .orientation
            .map_or_else(|| -now.tool.z_axis(), |o| o.normal())
    }

    fn touches(&self) -> bool {
        (self.task.phase.is_pressing() || self.task.phase == Phase::Retract)
            && self.run.weak_s == 0.0
    }
}

/// A reference at rest at `position` with the given `orientation`.
fn at_rest(position: Vector3<f64>, orientation: &OrientationReference) -> MotionReference {
    MotionReference {
        position,
        velocity: Vector3::zeros(),
        acceleration: Vector3::zeros(),
        rotation: orientation.rotation,
        angular: orientation.angular,
    }
}

/// Twist of a reference motion, m/s and rad/s.
fn twist_of(reference: &MotionReference) -> Vector6<f64> {
    stacked(&reference.velocity, &reference.angular)
}

/// Joint friction that the law compensates; zero if its parameters disable compensation.
fn friction<const N: usize>(config: &UnifiedForceImpedanceConfig) -> JointFriction<N> {
    if config.compensate_friction {
        config.friction.model()
    } else {
        JointFriction::from_lists(&[], &[], 1.0)
    }
}
