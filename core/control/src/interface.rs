//! What the controller takes and gives, once per robot cycle.

use nalgebra::Vector3;
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Aligned, Base, Joints, Pose, Tool, Twist, Wrench};
use tangent_sensing::{BaseMotion, Validity};

use crate::{Fault, Phase, SwitchCause};

/// Estimators that a task can name.
pub const MAX_ESTIMATORS: usize = 8;

/// One estimator's newest estimate.
#[derive(Clone, Copy, Debug)]
pub struct EstimateInput {
    /// What it says.
    pub estimate: NormalEstimate,
    /// How old it is now, s.
    pub age_s: f64,
}

/// One cycle as the controller sees it. Frames and signs as in DESIGN: the wrench is what the environment does to
/// the tool, so a pressing tool reads a negative z.
#[derive(Clone, Copy, Debug)]
pub struct ControlInput {
    /// Time of this cycle, s, on any clock that does not jump.
    pub time_s: f64,
    /// Nominal period, s.
    pub dt_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<6>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Measured velocity of the tool's origin, base axes.
    pub twist: Twist<Aligned<Tool, Base>>,
    /// Speed scaling in force on the robot, 0 to 1.
    pub speed_scaling: f64,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// Conditioned wrench at the tool.
    pub wrench: Wrench<Tool>,
    /// Whether to use it.
    pub wrench_validity: Validity,
    /// How old it is now, s.
    pub wrench_age_s: f64,
    /// Delay of its filter, s.
    pub wrench_delay_s: f64,
    /// Age of the tare in force, s; none if there was never one.
    pub bias_age_s: Option<f64>,
    /// Newest estimates, in the order of [`crate::Controller::estimators`].
    pub estimates: [Option<EstimateInput>; MAX_ESTIMATORS],
    /// How the base moves now; none where it stands for good.
    pub base: Option<BaseMotion>,
}

/// What kind of command an output is; the numeric value is that of `ArmCommand.kind`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandKind {
    /// Stand still; nothing is asked of the arm.
    #[default]
    Hold = 0,
    /// Follow joint velocities.
    JointVelocity = 1,
    /// Give these joint torques.
    JointTorque = 2,
}

/// One cycle's command and everything that `ControlState` publishes.
#[derive(Clone, Copy, Debug)]
pub struct ControlOutput {
    /// Kind of command.
    pub kind: CommandKind,
    /// Joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Bound on joint acceleration for this cycle, rad/s².
    pub acceleration: f64,
    /// The tool's velocity that `qd` stands for, base axes.
    pub twist_commanded: Twist<Aligned<Tool, Base>>,
    /// Phase after this cycle.
    pub phase: Phase,
    /// Counts task starts.
    pub activation: u64,
    /// Index in [`crate::Controller::estimators`] of the one in use.
    pub estimator: usize,
    /// Why that one.
    pub estimator_cause: SwitchCause,
    /// Changes of it since the task started.
    pub estimator_switches: u32,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Pressing force asked for along the normal, N.
    pub force_reference_n: f64,
    /// Pressing force measured along the normal, N.
    pub force_n: f64,
    /// Wrench used, tool axes; zero when there is none to use.
    pub wrench: Wrench<Tool>,
    /// Where the path wants the tool's origin, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Distance from it in the tangent plane, m.
    pub path_error_m: f64,
    /// 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// Age of the wrench used, s.
    pub wrench_age_s: f64,
    /// Age of the estimate in use, s; -1 without one.
    pub estimate_age_s: f64,
    /// Age of the base's pose in use, s; -1 where the base stands for good.
    pub base_age_s: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// The tool touches the surface, by the force.
    pub in_contact: bool,
    /// A tare is due now: the caller asks for one, and keeps the arm's state coming.
    pub tare_requested: bool,
    /// Contact stiffness in use, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the admittance in use along the normal, Ns/m.
    pub damping_n_s_per_m: f64,
    /// Energy that may still be put into the surface, J; none where nothing bounds it.
    pub force_tank_j: Option<f64>,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
}

impl ControlOutput {
    /// Nothing to do: the arm stands still, the tool's own axis for a normal.
    pub fn hold(input: &ControlInput) -> Self {
        Self {
            kind: CommandKind::Hold,
            qd: Joints::<6>::zeros(),
            acceleration: 0.0,
            twist_commanded: Twist::zero(),
            phase: Phase::Idle,
            activation: 0,
            estimator: 0,
            estimator_cause: SwitchCause::Task,
            estimator_switches: 0,
            normal: -input.base_from_tool.z_axis(),
            force_reference_n: 0.0,
            force_n: 0.0,
            wrench: Wrench::zero(),
            path_reference: input.base_from_tool.translation(),
            path_error_m: 0.0,
            path_progress: 0.0,
            alignment_error_rad: 0.0,
            wrench_age_s: input.wrench_age_s,
            estimate_age_s: -1.0,
            base_age_s: input.base.map_or(-1.0, |base| base.age_s),
            manipulability: 0.0,
            contact_lost_count: 0,
            in_contact: false,
            tare_requested: false,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            force_tank_j: None,
            fault: None,
        }
    }
}
