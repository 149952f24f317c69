//! Inputs and outputs of `hybrid_dynamics`, once per control period.

use nalgebra::Vector3;
use tangent_estimation::ObjectEstimate;
use tangent_mechanics::{Base, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use crate::inputs::UntaredLoad;
use crate::leaving::clearance::Clearance;
use crate::limits::faults::Fault;
use crate::phase_machine::Phase;

/// Inputs of one control period. The wrench is that of the environment on the tool.
#[derive(Clone, Copy, Debug)]
pub struct HybridInput<const N: usize = 6> {
    /// Time of this period, s, on any clock that does not jump.
    pub time_s: f64,
    /// Nominal period, s.
    pub dt_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<N>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// Conditioned wrench at the tool.
    pub wrench: Wrench<Tool>,
    /// Whether the wrench can be used.
    pub wrench_validity: Validity,
    /// Age of the wrench, s.
    pub wrench_age_s: f64,
    /// Age of the tare in force, s; `None` if there is none.
    pub bias_age_s: Option<f64>,
    /// Bound on the error of the zero, by its age, N; `None` if it is not known.
    pub zero_bound_n: Option<f64>,
    /// Reading before any zero is subtracted; `None` if the sensor service does not provide it.
    pub untared: Option<UntaredLoad>,
    /// Newest estimate of the object's pose.
    pub estimate: Option<ObjectEstimate>,
    /// Age of the newest estimate, s.
    pub estimate_age_s: f64,
}

/// Command of one control period, and the quantities behind it.
#[derive(Clone, Copy, Debug)]
pub struct HybridOutput<const N: usize = 6> {
    /// Motor torques, Nm, within the arm's limits.
    pub torque: Joints<N>,
    /// Phase after this period.
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// Whether a tare is due.
    pub tare_requested: bool,
    /// Whether the phase is one in which the tool presses on the surface.
    pub in_contact: bool,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Desired pressing force along the normal, N; the paper's -λ_d.
    pub force_reference_n: f64,
    /// Pressing force measured along the normal in use, N; the paper's -λ. `None` if no wrench can
    /// be used.
    pub force_n: Option<f64>,
    /// Whether the tool may touch something. The next start depends on it.
    pub clearance: Clearance,
    /// Whether the zero in force turned out to have been taken in contact. The caller then has the
    /// sensor service withdraw it.
    pub zero_withdrawn: bool,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Reference position of the tool's origin on the path, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Reference position of the tool's origin in object axes, m; `None` if the path was not
    /// planned on the object.
    pub reference_in_object: Option<Vector3<f64>>,
    /// Distance of the tool's origin from the reference in the tangent plane, m.
    pub path_error_m: f64,
    /// Progress along the path, 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Whether a torque or joint limit cut the command.
    pub limited: bool,
}
