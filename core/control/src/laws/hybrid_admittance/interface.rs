//! Inputs and outputs of the controller, once per robot cycle.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Base, Joints, Tool, Twist, Wrench};
use tangent_schemas::CommandKind;

use crate::estimator_choice::switching::SwitchCause;
use crate::law::LawInput;
use crate::leaving::clearance::Clearance;
use crate::limits::faults::Fault;
use crate::limits::plausibility::is_place;
use crate::phase_machine::Phase;

/// Inputs of one cycle of this law.
pub type ControlInput<const N: usize = 6> = LawInput<N>;

/// Command of one cycle, and everything that `ControlState` publishes.
#[derive(Clone, Copy, Debug)]
pub struct ControlOutput<const N: usize = 6> {
    /// Kind of command.
    pub kind: CommandKind,
    /// Joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Bound on joint acceleration for this cycle, rad/s².
    pub acceleration: f64,
    /// Velocity of the tool that corresponds to `qd`, base axes, m/s and rad/s.
    pub twist_commanded: Twist<Aligned<Tool, Base>>,
    /// Phase after this cycle.
    pub phase: Phase,
    /// Number of task starts.
    pub activation: u64,
    /// Index of the estimator in use in [`super::controller::Controller::estimators`].
    pub estimator: usize,
    /// Cause of the last change of the estimator.
    pub estimator_cause: SwitchCause,
    /// Number of changes of the estimator since the task started.
    pub estimator_switches: u32,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Desired pressing force along the normal, N.
    pub force_reference_n: f64,
    /// Pressing force measured along the normal, N; `None` if no wrench can be used.
    pub force_n: Option<f64>,
    /// Wrench used, tool axes; `None` if none can be used.
    pub wrench: Option<Wrench<Tool>>,
    /// Whether the tool may touch something. The next start depends on it, also under another
    /// controller.
    pub clearance: Clearance,
    /// Whether the zero in force turned out to have been taken in contact. The caller then has the
    /// sensor's service withdraw it.
    pub zero_withdrawn: bool,
    /// Reference position of the tool's origin on the path, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Distance of the tool's origin from the reference in the tangent plane, m.
    pub path_error_m: f64,
    /// Progress along the path, 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// Age of the wrench used, s.
    pub wrench_age_s: f64,
    /// Age of the estimate in use, s; -1 without one.
    pub estimate_age_s: f64,
    /// Age of the base's pose in use, s; -1 if the base never moves.
    pub base_age_s: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// Whether the force shows that the tool touches the surface.
    pub in_contact: bool,
    /// Whether a tare is due: the caller requests one, and continues to provide the arm's state.
    pub tare_requested: bool,
    /// Contact stiffness in use, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the admittance in use along the normal, Ns/m.
    pub damping_n_s_per_m: f64,
    /// Energy that may still be put into the surface, J; `None` if it is not bounded.
    pub force_tank_j: Option<f64>,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
}

impl<const N: usize> ControlOutput<N> {
    /// No task: the arm stands still, and the tool's own axis is the normal.
    pub fn hold(input: &ControlInput<N>) -> Self {
        // The outputs are finite even if the arm's pose is not.
        let (normal, path_reference) = if is_place(&input.base_from_tool) {
            let tool = &input.base_from_tool;
            (-tool.z_axis(), tool.translation())
        } else {
            (Vector3::z(), Vector3::zeros())
        };
        Self {
            kind: CommandKind::Hold,
            qd: Joints::<N>::zeros(),
            acceleration: 0.0,
            twist_commanded: Twist::zero(),
            phase: Phase::Idle,
            activation: 0,
            estimator: 0,
            estimator_cause: SwitchCause::Task,
            estimator_switches: 0,
            normal,
            force_reference_n: 0.0,
            force_n: None,
            wrench: None,
            clearance: Clearance::Assumed,
            zero_withdrawn: false,
            path_reference,
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
