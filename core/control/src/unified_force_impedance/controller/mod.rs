//! The law in its period: what is felt and seen, and which torques follow. What it makes of what it
//! feels is in `senses`, the phases are in `phase_steps`, the torques' make-up in `torques`.

mod leaving;
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
use crate::departure::Departure;
use crate::error::check_range;
use crate::interface::{is_arm_state, is_time};
use crate::response_guard::ResponseGuard;
use crate::wrench_guard::{WrenchGuard, WrenchVerdict};
use crate::{Clearance, ControlError, Fault, Limits, Path, Phase, Task};

/// Of the robot, until it says so, s.
const PERIOD_S: f64 = 0.001;
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
    response: ResponseGuard,
    /// Sum of what the wrench read standing still, and over how many periods.
    zero: (Vector6<f64>, f64),
    /// What was felt when the wrench was good last.
    felt: Option<Felt>,
    departure: Departure,
    /// When the zero was taken, s of the run; none before.
    zeroed_s: Option<f64>,
    /// Where, until something is touched.
    tared_at: Option<Vector3<f64>>,
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
    /// What was asked of the tool last, N and Nm, base axes, in which way, and what is left of the
    /// way before.
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
    blind_s: f64,
    /// With the motion tank's valve shut, s.
    empty_s: f64,
    torque: Option<Joints<JOINTS>>,
    /// No finite torques followed in this period.
    lost: bool,
    /// The last that could be computed with, s.
    period_s: f64,
    held_torque: Joints<JOINTS>,
    limited: bool,
}

/// What is felt in one period.
#[derive(Clone, Copy, Debug)]
struct Felt {
    verdict: WrenchVerdict,
    /// Tool axes; none where none can be used. A bad sample is waited out with the last good one.
    wrench: Option<Vector6<f64>>,
    /// Along the direction that is pushed in, N.
    pressing_n: Option<f64>,
    /// A good reading that is beyond its limit before any zero.
    hidden: bool,
}

impl Felt {
    /// What presses, by a wrench of this period.
    fn pressing_now_n(&self) -> Option<f64> {
        self.pressing_n
            .filter(|_| self.verdict == WrenchVerdict::Good)
    }
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
        self.begin(self.run.departure.clearance);
    }

    /// Begins the task with what is known of the tool. In doubt whether it hangs free, it moves off
    /// first.
    pub fn begin(&mut self, clearance: Clearance) {
        self.run = Run::new(&self.config);
        self.run.departure = Departure::new(clearance);
        self.run.phase = if clearance.is_free() {
            self.task.phase_at_rest()
        } else {
            Phase::Clear
        };
    }

    /// Whether the tool may touch something: what the next start goes by.
    pub fn clearance(&self) -> Clearance {
        self.run.departure.clearance
    }

    /// Whether a task may start with the tool at `position` (base axes, m) after what is known of
    /// it.
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] where the tool may touch something and which way is away is not
    /// known.
    pub fn check_start(
        &self,
        clearance: &Clearance,
        position: &Vector3<f64>,
    ) -> Result<(), ControlError> {
        clearance.way_out(&self.config.leave, position).map(drop)
    }

    /// Ends the task: the tool leaves the surface.
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

    /// Stands still in every phase: the policy stops where it is, what presses keeps its force;
    /// false goes on.
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

    /// The task has ended, and the tool may still be where it touched.
    pub fn is_left_on_surface(&self) -> bool {
        !self.run.phase.is_active()
            && self.run.lay.is_some()
            && self.run.departure.may_be_on_surface()
    }

    /// Retracts a tool that [is left on the surface](Self::is_left_on_surface), over the way of the
    /// task's end.
    pub fn leave_surface(&mut self) {
        if !self.is_left_on_surface() {
            return;
        }
        // Nothing of what moved or pushed before is left: the arm may have been moved since.
        self.run.paused = false;
        self.run.torque = None;
        self.run.push_n = 0.0;
        self.run.last_wrench = Vector6::zeros();
        self.run.bridge = Vector6::zeros();
        self.run.was_pressing = false;
        self.run.drawn = Vector3::zeros();
        let ended = if self.run.fault.is_some() {
            Phase::Fault
        } else {
            Phase::Done
        };
        self.leave(ended);
    }

    /// The task is paused.
    pub fn is_paused(&self) -> bool {
        self.run.phase.is_active() && self.run.stands()
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
        if !is_time(input.time_s, dt) || !is_arm_state(&input.q, &input.qd) {
            return self.blind_output();
        }
        self.run.period_s = dt;
        let now = ArmNow::new(&self.model, &self.flange_from_tool, &input.q, &input.qd);
        // No time limit runs while the task is paused.
        if !self.run.stands() {
            self.run.since_s += dt;
            self.run.phase_s += dt;
        }
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
        let (away, position) = (self.smooth_normal(&now), now.tool.translation());
        self.run.departure.remember(self.run.phase, away, position);
        let error = pose_error(&now, &wanted.reference);
        let rho_force = self.watch(&wanted, &now, &normal, &felt, &error, dt);
        let (torque, force_reference_n) = self.torques(&wanted, &now, &felt, &error, rho_force, dt);
        if self.run.lost {
            self.run.lost = false;
            return self.blind_output();
        }
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
            wrench: felt.wrench.map(|wrench| Wrench::from_vector(&wrench)),
            clearance: self.run.departure.clearance,
            zero_age_s: self.zero_age_s(),
            zero_bound_n: self.zero_bound_n(),
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

    /// The arm's state or its period is no number, or nothing finite follows from them: what held
    /// it against gravity last is the best guess, and what moved it or pushed fades.
    fn blind_output(&mut self) -> UnifiedOutput {
        self.run.fault = Some(Fault::ArmState);
        self.enter(Phase::Fault);
        self.run.held = None;
        let held = self.run.held_torque;
        let share = (self.run.period_s / FADE_S).min(1.0);
        let last = self.run.torque.unwrap_or(held);
        let torque = last + (held - last) * share;
        self.run.torque = Some(torque);
        // The books hold what is in force in each period, this one's too.
        let fading = self.run.tanks.committed() * (1.0 - share);
        self.run.tanks.commit(fading);
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
            wrench: None,
            clearance: self.run.departure.clearance,
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

    /// Off the surface, then `then`; straight there where the tool stands as it did at the start,
    /// or moves off already.
    fn leave(&mut self, then: Phase) {
        if matches!(self.run.phase, Phase::Tare | Phase::Clear) {
            self.run.held = None;
            return self.enter(then);
        }
        self.run.departure.begin_retraction(then);
        self.run.held = None;
        self.enter(Phase::Retract);
    }

    fn fail(&mut self, fault: Fault) {
        self.run.fault = Some(fault);
        self.leave(Phase::Fault);
    }
}

impl Run {
    /// Paused, and not on its way off the surface.
    fn stands(&self) -> bool {
        self.paused && self.phase != Phase::Retract
    }

    fn new(config: &UnifiedForceImpedanceConfig) -> Self {
        Self {
            paused: false,
            phase: Phase::Tare,
            fault: None,
            since_s: 0.0,
            phase_s: 0.0,
            guard: WrenchGuard::default(),
            response: ResponseGuard::default(),
            zero: (Vector6::zeros(), 0.0),
            felt: None,
            departure: Departure::default(),
            zeroed_s: None,
            tared_at: None,
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
            blind_s: 0.0,
            empty_s: 0.0,
            torque: None,
            lost: false,
            period_s: PERIOD_S,
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
