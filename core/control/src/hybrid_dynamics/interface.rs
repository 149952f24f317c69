//! What `hybrid_dynamics` takes and gives, once per control period.

use nalgebra::Vector3;
use tangent_estimation::ObjectEstimate;
use tangent_mechanics::{Base, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use crate::{Clearance, Fault, Phase, UntaredLoad};

/// One period as the controller sees it. The wrench is what the environment does to the tool.
#[derive(Clone, Copy, Debug)]
pub struct HybridInput {
    /// Time of this period, s, on any clock that does not jump.
    pub time_s: f64,
    /// Nominal period, s.
    pub dt_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<6>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// Conditioned wrench at the tool.
    pub wrench: Wrench<Tool>,
    /// Whether to use it.
    pub wrench_validity: Validity,
    /// How old it is now, s.
    pub wrench_age_s: f64,
    /// Age of the tare in force, s; none if there was never one.
    pub bias_age_s: Option<f64>,
    /// Error of the zero that its age implies, N; none where that is not known.
    pub zero_bound_n: Option<f64>,
    /// The reading before any zero was taken off; none where the sensor's service does not tell.
    pub untared: Option<UntaredLoad>,
    /// Newest estimate of the object's pose.
    pub estimate: Option<ObjectEstimate>,
    /// How old it is now, s.
    pub estimate_age_s: f64,
}

/// One period's command and what it was made of.
#[derive(Clone, Copy, Debug)]
pub struct HybridOutput {
    /// Motor torques, Nm, within the arm's limits.
    pub torque: Joints<6>,
    /// Phase after this period.
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// A tare is due now.
    pub tare_requested: bool,
    /// The tool touches, by the force.
    pub in_contact: bool,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Pressing force asked for along the normal, N; the paper's -λ_d.
    pub force_reference_n: f64,
    /// Pressing force measured along the normal in use, N; the paper's -λ. None where no wrench can be used.
    pub force_n: Option<f64>,
    /// Whether the tool may touch something. The next start goes by it.
    pub clearance: Clearance,
    /// The zero in force turned out to be taken in contact: the caller has the sensor's service take it back.
    pub zero_withdrawn: bool,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Where the path wants the tool's origin, base axes, m.
    pub path_reference: Vector3<f64>,
    /// The same in object axes, where the path was drawn on the object, m.
    pub reference_in_object: Option<Vector3<f64>>,
    /// Distance from it in the tangent plane, m.
    pub path_error_m: f64,
    /// 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// A torque or joint limit cut the command.
    pub limited: bool,
}
