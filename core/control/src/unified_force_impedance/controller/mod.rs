//! The law in its period: what is felt and seen, and which torques follow. What it makes of what it feels is in `senses`, the phases are in
//! `phase_steps`, the torques' make-up in `torques`.

mod phase_steps;
mod senses;
mod torques;

use nalgebra::{Matrix3, Vector3, Vector6};
use tangent_mechanics::{Arm, Flange, JointFriction, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use super::config::UnifiedForceImpedanceConfig;
use super::energy::{DELAY_MAX, Tanks};
use super::fused_normal::FusedNormal;
use super::interface::{JOINTS, TorqueInterface, UnifiedInput, UnifiedOutput};
use super::law::{ArmNow, ForceLoop, MotionReference, pose_error, stacked};
use super::monitor::Monitor;
use super::orientation::OrientationReference;
use crate::error::check_range;
use crate::wrench_guard::{WrenchGuard, WrenchVerdict};
use crate::{ControlError, Fault, Limits, Path, Phase, Profile, Task};

/// A period outside these is a mistake, s.
const DT_LEAST_S: f64 = 1e-5;
const DT_MOST_S: f64 = 0.1;
/// Time in which the last torques fade into what holds the arm, where its state is no number, s.
const FADE_S: f64 = 0.025;

/// The controller. One [`UnifiedForceImpedance::step`] per control period; nothing in it allocates.
pub struct UnifiedForceImpedance {
    model: Arm<JOINTS>,
    flange_from_tool: Pose<Flange, Tool>,
    limits: Limits,
    config: UnifiedForceImpedanceConfig,
    friction: JointFriction<JOINTS>,
    task: Task,
    path: Path,
    interface: TorqueInterface,
    run: Run,
}

/// Where the policy lies: its origin and axes, base axes.
#[derive(Clone, Copy, Debug)]
struct Lay {
    origin: Vector3<f64>,
    x: Vector3<f64>,
    y: Vector3<f64>,
    /// Against the approach.
    up: Vector3<f64>,
}

/// Memory of one task.
#[derive(Clone, Copy, Debug)]
struct Run {
    paused: bool,
    phase: Phase,
    fault: Option<Fault>,
    since_s: f64,
    /// In this phase, s.
    phase_s: f64,
    guard: WrenchGuard,
    /// Sum of what the wrench read standing still, and over how many periods.
    zero: (Vector6<f64>, f64),
    /// What was felt when the wrench was good last.
    felt: Option<Felt>,
    /// The joints' friction as it stands in the robot's estimate, base axes.
    rubbing: Vector6<f64>,
    fused: FusedNormal,
    orientation: Option<OrientationReference>,
    monitor: Monitor,
    tanks: Tanks,
    force: ForceLoop,
    /// Where the tool is kept while nothing else is wanted.
    held: Option<Vector3<f64>>,
    /// Way of the approach, m, and its speed, m/s.
    approach: (f64, f64),
    lay: Option<Lay>,
    path_s: f64,
    /// Rate of the policy's clock, 0 to 1.
    rate: f64,
    /// What the policy was moved by when the arm was limp, m.
    offset: Vector3<f64>,
    /// Where the tool touched last, m.
    last_contact: Vector3<f64>,
    last_velocity: Vector3<f64>,
    /// Of the policy, m/s².
    acceleration: Vector3<f64>,
    reference_n: f64,
    /// What the force controller pushed with last, N.
    push_n: f64,
    /// What was asked of the tool last, N and Nm, base axes, in which way, and what is left of the way before.
    last_wrench: Vector6<f64>,
    was_pressing: bool,
    bridge: Vector6<f64>,
    /// Integral of the path's error, N.
    drawn: Vector3<f64>,
    surface_friction: f64,
    weak_cycles: u32,
    strong_cycles: u32,
    lost_count: u32,
    sought_m: f64,
    retract: Option<(Vector3<f64>, Profile)>,
    after_retract: Phase,
    blind_s: f64,
    /// With the motion tank's valve shut, s.
    empty_s: f64,
    torque: Option<Joints<JOINTS>>,
    held_torque: Joints<JOINTS>,
    limited: bool,
}

/// What is felt in one period.
#[derive(Clone, Copy, Debug)]
struct Felt {
    verdict: WrenchVerdict,
    /// Tool axes.
    wrench: Vector6<f64>,
    /// Along the direction that is pushed in, N.
    pressing_n: f64,
}

/// What one phase wants.
#[derive(Clone, Copy, Debug)]
struct Wanted {
    reference: MotionReference,
    /// Where the policy wants the tool, m.
    policy: Vector3<f64>,
    pressing: bool,
}

impl UnifiedForceImpedance {
    /// For an arm with what it carries, what takes its torques, and a task.
    ///
    /// # Errors
    /// A parameter, limit or task out of its range.
    pub fn new(
        model: Arm<JOINTS>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: &UnifiedForceImpedanceConfig,
        task: &Task,
        interface: TorqueInterface,
    ) -> Result<Self, ControlError> {
        limits.check()?;
        config.check()?;
        task.check()?;
        let delay = interface.delay_periods as f64;
        check_range("delay_periods", delay, 0.0, DELAY_MAX as f64)?;
        check_range("effort_share", interface.effort_share, 0.01, 1.0)?;
        check_range("rate_share", interface.rate_share, 0.01, 1.0)?;
        let path = Path::new(
            &task.path,
            config.path.acceleration_m_per_s2,
            config.path.jerk_m_per_s3,
        )?;
        Ok(Self {
            model,
            flange_from_tool,
            limits,
            friction: if config.compensate_friction {
                config.friction.model()
            } else {
                JointFriction::from_lists(&[], &[], 1.0)
            },
            run: Run::new(config),
            config: config.clone(),
            task: task.clone(),
            path,
            interface,
        })
    }

    /// Begins the task anew, with the tanks as at the start.
    pub fn restart(&mut self) {
        self.run = Run::new(&self.config);
    }

    /// Ends the task: the tool leaves the surface.
    pub fn stop(&mut self) {
        if self.run.phase.is_active() {
            self.leave(Phase::Done);
        }
    }

    /// Stops the policy where it is, keeps the force; false goes on.
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
        self.run.paused = paused;
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
    pub fn step(&mut self, input: &UnifiedInput) -> UnifiedOutput {
        let dt = input.dt_s;
        let sound = input.q.iter().chain(input.qd.iter()).all(|x| x.is_finite())
            && input.time_s.is_finite()
            && (DT_LEAST_S..=DT_MOST_S).contains(&dt);
        if !sound {
            return self.blind_output(dt);
        }
        let now = ArmNow::new(&self.model, &self.flange_from_tool, &input.q, &input.qd);
        self.run.since_s += dt;
        self.run.phase_s += dt;
        self.run
            .tanks
            .settle(&self.config.tanks, &input.q, self.interface.delay_periods);
        let normal = self.run.fused.step(
            &self.config.fusion,
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
        let error = pose_error(&now, &wanted.reference);
        let rho_force = self.watch(&wanted, &now, &normal, &felt, &error, dt);
        let (torque, force_reference_n) = self.torques(&wanted, &now, &felt, &error, rho_force, dt);
        let away = now.tool.translation() - wanted.policy;
        let n = &normal.normal;
        UnifiedOutput {
            torque,
            held_torque: self.run.held_torque,
            phase: self.run.phase,
            fault: self.run.fault,
            in_contact: self.touches(),
            contact_lost_count: self.run.lost_count,
            normal: *n,
            normal_covariance: normal.covariance,
            normal_validity: normal.validity,
            wrench: Wrench::from_vector(&felt.wrench),
            force_reference_n,
            force_n: felt.pressing_n,
            base_from_tool: now.tool,
            path_reference: wanted.policy,
            path_error_m: (away - n * n.dot(&away)).norm(),
            path_progress: (self.run.path_s / self.path.duration_s().max(1e-9)).min(1.0),
            alignment_error_rad: n.angle(&-now.tool.z_axis()),
            monitor: self.run.monitor.value,
            monitor_margin: self.run.monitor.margin(&self.config.monitor),
            rho_align: self.run.monitor.rho,
            rho_force,
            tanks: self.run.tanks.books(),
            friction: self.run.surface_friction,
            manipulability: now.manipulability(),
            limited: self.run.limited,
        }
    }

    /// The arm's state is no number: what held it against gravity last is the best guess, and what moved it or pushed fades.
    fn blind_output(&mut self, dt: f64) -> UnifiedOutput {
        self.run.fault = Some(Fault::ArmState);
        self.enter(Phase::Fault);
        self.run.held = None;
        let held = self.run.held_torque;
        let share = if dt.is_finite() {
            (dt / FADE_S).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let last = self.run.torque.unwrap_or(held);
        let torque = last + (held - last) * share;
        self.run.torque = Some(torque);
        UnifiedOutput {
            torque,
            held_torque: held,
            phase: Phase::Fault,
            fault: self.run.fault,
            in_contact: false,
            contact_lost_count: self.run.lost_count,
            normal: Vector3::z(),
            normal_covariance: Matrix3::identity(),
            normal_validity: Validity::Missing,
            wrench: Wrench::zero(),
            force_reference_n: 0.0,
            force_n: 0.0,
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

    /// Where a push goes, base axes: the tool's z axis as published, or against the normal.
    fn push_direction(&self, now: &ArmNow) -> Vector3<f64> {
        if self.config.force.along_normal {
            -self.smooth_normal(now)
        } else {
            now.tool.z_axis()
        }
    }

    /// The normal in use as the tool is turned to it: without the jumps of frames that come and go.
    fn smooth_normal(&self, now: &ArmNow) -> Vector3<f64> {
        self.run
            .orientation
            .map_or_else(|| -now.tool.z_axis(), |o| o.normal())
    }

    fn touches(&self) -> bool {
        (self.run.phase.is_pressing() || self.run.phase == Phase::Retract)
            && self.run.weak_cycles == 0
    }

    fn enter(&mut self, phase: Phase) {
        if self.run.phase != phase {
            self.run.phase = phase;
            self.run.phase_s = 0.0;
        }
    }

    /// Off the surface, then `then`.
    fn leave(&mut self, then: Phase) {
        self.run.after_retract = then;
        self.run.retract = None;
        self.run.held = None;
        self.enter(Phase::Retract);
    }

    fn fail(&mut self, fault: Fault) {
        self.run.fault = Some(fault);
        self.leave(Phase::Fault);
    }
}

impl Run {
    fn new(config: &UnifiedForceImpedanceConfig) -> Self {
        Self {
            paused: false,
            phase: Phase::Tare,
            fault: None,
            since_s: 0.0,
            phase_s: 0.0,
            guard: WrenchGuard::default(),
            zero: (Vector6::zeros(), 0.0),
            felt: None,
            rubbing: Vector6::zeros(),
            fused: FusedNormal::default(),
            orientation: None,
            monitor: Monitor::new(),
            tanks: Tanks::new(&config.tanks),
            force: ForceLoop::default(),
            held: None,
            approach: (0.0, 0.0),
            lay: None,
            path_s: 0.0,
            rate: 0.0,
            offset: Vector3::zeros(),
            last_contact: Vector3::zeros(),
            last_velocity: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            reference_n: 0.0,
            push_n: 0.0,
            last_wrench: Vector6::zeros(),
            was_pressing: false,
            bridge: Vector6::zeros(),
            drawn: Vector3::zeros(),
            surface_friction: 0.0,
            weak_cycles: 0,
            strong_cycles: 0,
            lost_count: 0,
            sought_m: 0.0,
            retract: None,
            after_retract: Phase::Idle,
            blind_s: 0.0,
            empty_s: 0.0,
            torque: None,
            held_torque: Joints::zeros(),
            limited: false,
        }
    }
}

/// A reference at rest at `position` with the tool turned as `orientation` says.
fn at_rest(position: Vector3<f64>, orientation: &OrientationReference) -> MotionReference {
    MotionReference {
        position,
        velocity: Vector3::zeros(),
        acceleration: Vector3::zeros(),
        rotation: orientation.rotation,
        angular: orientation.angular,
    }
}

/// Twist of a reference.
fn twist_of(reference: &MotionReference) -> Vector6<f64> {
    stacked(&reference.velocity, &reference.angular)
}
