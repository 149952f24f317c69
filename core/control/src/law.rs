//! The interface of all control laws: inputs and outputs of one cycle of the arm, and requests to a
//! law between two cycles.
//!
//! Called by the closed loops of `evaluate` and by the loop of the `controller` service.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Base, Joints, Pose, Tool, Twist, Wrench};
use tangent_schemas::CommandKind;
use tangent_sensing::{BaseMotion, Validity};

use crate::coverage::CoverageResult;
use crate::error::ControlError;
use crate::estimator_choice::switching::{SwitchCause, SwitchRefusal};
use crate::inputs::{EstimateInput, MAX_ESTIMATORS, ObjectInput, UntaredLoad, VisionInput};
use crate::learning::EndedPass;
use crate::leaving::clearance::Clearance;
use crate::limits::faults::Fault;
use crate::parameters::law_config::LawConfig;
use crate::parameters::live::Parameter;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::{EstimatorName, Program};

/// Inputs of one cycle. The wrench is that of the environment on the tool: a pressing tool reads a
/// negative z. A law reads what it needs of them.
#[derive(Clone, Copy, Debug)]
pub struct LawInput<const N: usize> {
    /// Time of this cycle, s, on any clock that does not jump.
    pub time_s: f64,
    /// Nominal period, s.
    pub dt_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<N>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Measured velocity of the tool's origin, base axes, m/s and rad/s.
    pub twist: Twist<Aligned<Tool, Base>>,
    /// Speed scaling in force on the robot, 0 to 1.
    pub speed_scaling: f64,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// Conditioned wrench at the tool, N and Nm.
    pub wrench: Wrench<Tool>,
    /// Whether the wrench can be used.
    pub wrench_validity: Validity,
    /// Age of the wrench, s.
    pub wrench_age_s: f64,
    /// Delay of the wrench's filter, s.
    pub wrench_delay_s: f64,
    /// Age of the tare in force, s; `None` without one.
    pub bias_age_s: Option<f64>,
    /// Bound on the error of the zero, by its age, N; `None` where it is not known.
    pub zero_bound_n: Option<f64>,
    /// Reading before any zero is subtracted; `None` where the sensor's service does not provide
    /// it.
    pub untared: Option<UntaredLoad>,
    /// Force of the environment on the flange as the arm itself measures or estimates it, without
    /// the weight of the tool, flange axes, N; `None` unless it is fresh and independent of the
    /// sensor.
    pub arm_force: Option<Vector3<f64>>,
    /// Newest normals, in the order of [`Law::estimators`].
    pub estimates: [Option<EstimateInput>; MAX_ESTIMATORS],
    /// Newest poses of an object, in the order of [`Law::estimators`].
    pub objects: [Option<ObjectInput>; MAX_ESTIMATORS],
    /// Newest normal from the camera.
    pub vision: Option<VisionInput>,
    /// Motion of a moving base; `None` where the base does not move.
    pub base: Option<BaseMotion>,
}

impl<const N: usize> LawInput<N> {
    /// Distance that the tool slid in this cycle, m, if `phase` is the one in which it slides.
    pub(crate) fn slid_m(&self, phase: Phase) -> f64 {
        if phase == Phase::Slide {
            self.twist.linear.norm() * self.dt_s
        } else {
            0.0
        }
    }
}

/// Command to the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointCommand<const N: usize> {
    /// Kind of the values.
    pub kind: CommandKind,
    /// Values, rad/s or Nm, base to flange.
    pub values: Joints<N>,
    /// Bound on the joints' acceleration in this cycle, rad/s²; 0 for torques.
    pub acceleration: f64,
}

/// Estimator in use.
#[derive(Clone, Copy, Debug)]
pub struct EstimatorInUse {
    /// Its name.
    pub name: EstimatorName,
    /// Number of changes since the task started.
    pub switches: u32,
    /// Cause of the last change.
    pub cause: SwitchCause,
}

/// Contact monitor and shaping of the unified force-impedance law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shaping {
    /// Contact-alignment monitor C, eq. (17).
    pub monitor: f64,
    /// Its margin `C_m` in use.
    pub monitor_margin: f64,
    /// `ρ_align`, eq. (20).
    pub rho_align: f64,
    /// `ρ_frc`, eq. (30).
    pub rho_force: f64,
}

/// Command of one cycle, and what is published about it.
#[derive(Clone, Copy, Debug)]
pub struct LawOutput<const N: usize> {
    /// Command to the joints.
    pub command: JointCommand<N>,
    /// Phase after this cycle.
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// Whether a tare is due.
    pub tare_requested: bool,
    /// Whether the tool may touch something. The next start depends on it.
    pub clearance: Clearance,
    /// Whether the zero in force turned out to have been taken in contact. The caller then has the
    /// sensor's service withdraw it.
    pub zero_withdrawn: bool,
    /// Estimator in use; `None` without a task.
    pub estimator: Option<EstimatorInUse>,
    /// Age of the estimate in use, s; `None` without one.
    pub estimate_age_s: Option<f64>,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Desired pressing force along the normal, N.
    pub force_reference_n: f64,
    /// Pressing force measured along the normal, N; `None` where no wrench can be used.
    pub force_n: Option<f64>,
    /// Wrench used, N and Nm; `None` where none can be used.
    pub wrench: Option<Wrench<Tool>>,
    /// Age of the wrench, s; infinite without one.
    pub wrench_age_s: f64,
    /// Age of the zero in force, s; `None` without one.
    pub zero_age_s: Option<f64>,
    /// Bound on the error of that zero, N; `None` where it is not known.
    pub zero_bound_n: Option<f64>,
    /// Reference position of the tool's origin on the path, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Distance of the tool's origin from the reference in the tangent plane, m.
    pub path_error_m: f64,
    /// Progress along the path, 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// Energy in the motion tank, J; 0 for a law without one.
    pub motion_tank_j: f64,
    /// Energy in the force tank, J; 0 for a law without one.
    pub force_tank_j: f64,
    /// Monitor and shaping; `None` for a law that does not shape.
    pub shaping: Option<Shaping>,
}

impl<const N: usize> LawOutput<N> {
    /// Output before the first task: the arm holds itself.
    pub fn idle(input: &LawInput<N>, clearance: Clearance) -> Self {
        Self {
            command: JointCommand {
                kind: CommandKind::Hold,
                values: Joints::<N>::zeros(),
                acceleration: 0.0,
            },
            phase: Phase::Idle,
            fault: None,
            tare_requested: false,
            clearance,
            zero_withdrawn: false,
            estimator: None,
            estimate_age_s: None,
            normal: Vector3::zeros(),
            force_reference_n: 0.0,
            force_n: None,
            wrench: None,
            wrench_age_s: f64::INFINITY,
            zero_age_s: None,
            zero_bound_n: None,
            path_reference: input.base_from_tool.translation(),
            path_error_m: 0.0,
            path_progress: 0.0,
            alignment_error_rad: 0.0,
            manipulability: 0.0,
            contact_lost_count: 0,
            motion_tank_j: 0.0,
            force_tank_j: 0.0,
            shaping: None,
        }
    }
}

/// Circumstances of a task start.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// Whether a person confirms that the tool is free.
    pub said_clear: bool,
    /// Position of the tool's origin, base axes, m.
    pub position: Vector3<f64>,
    /// Activation that the arm has latched out. That of the start is greater.
    pub latched: u64,
}

/// A control law for an arm of `N` joints. The loop calls [`Law::step`] once per cycle of the arm,
/// and everything else between two cycles. Nothing here locks or allocates.
pub trait Law<const N: usize>: Send {
    /// Its parameters.
    type Config: LawConfig;

    /// Parameters that can be set while a task runs.
    const PARAMETERS: &'static [Parameter];

    /// Whether the law shapes its output: it then sets [`LawOutput::shaping`] while a task runs.
    const SHAPES: bool = false;

    /// Whether the law runs tasks with `[coverage]`: see [`Law::take_coverage`].
    const COVERS: bool = false;

    /// Runs one cycle.
    fn step(&mut self, input: &LawInput<N>) -> LawOutput<N>;

    /// Starts a program. The caller must drop what remains in `program` outside the loop. Called
    /// only while no task is active.
    ///
    /// # Errors
    /// The task may not start here. The state of the law is then unchanged.
    fn start(
        &mut self,
        program: &mut Option<Program<Self::Config>>,
        start: &Start,
    ) -> Result<(), ControlError>;

    /// Stands still in every phase: the path stops, and a pressing tool keeps its force. `false`
    /// resumes.
    ///
    /// # Errors
    /// No task runs, or it is retracting.
    fn pause(&mut self, paused: bool) -> Result<(), ControlError>;

    /// Whether the task is paused.
    fn is_paused(&self) -> bool;

    /// Ends the task with a retraction.
    fn stop(&mut self);

    /// Whether the task has ended with the tool possibly still on the surface.
    fn is_left_on_surface(&self) -> bool;

    /// Retracts a tool that is left on the surface; `latched` as in [`Start`].
    fn leave_surface(&mut self, latched: u64);

    /// The pass of a task that learns, once it has ended; `None` if it was taken before, and for a
    /// law that does not learn.
    fn take_pass(&mut self) -> Option<EndedPass> {
        None
    }

    /// What a task with `[coverage]` has covered, once at the end of each round that another one
    /// follows, and at the end of the task; otherwise `None`. Allocates nothing.
    fn take_coverage(&mut self) -> Option<CoverageResult> {
        None
    }

    /// Switches to another estimator. `force` waives the checks of validity and agreement.
    ///
    /// # Errors
    /// The estimator cannot be used now.
    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal>;

    /// Estimators to which the lists in [`LawInput`] refer, in this order.
    fn estimators(&self) -> &[EstimatorName];

    /// Sets one of [`Law::PARAMETERS`]. It takes effect over a ramp.
    fn set(&mut self, parameter: Parameter, value: f64);

    /// Value of a live parameter, or its target during a ramp.
    fn get(&self, parameter: Parameter) -> f64;

    /// Phase after the last cycle.
    fn phase(&self) -> Phase;

    /// Number of task starts, as the arm counts them.
    fn activation(&self) -> u64;

    /// Whether the tool may touch something. Persists across tasks.
    fn clearance(&self) -> Clearance;

    /// The running or last task.
    fn task(&self) -> Option<&Task>;
}
