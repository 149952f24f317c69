//! One cycle of a run, as the figures take it.

use nalgebra::{Matrix3, Vector3};
use tangent_control::Phase;

/// One cycle of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleSample {
    /// Time of the cycle, s.
    pub time_s: f64,
    /// The task's phase.
    pub phase: Phase,
    /// Newest estimate of the estimator in use.
    pub estimate: Option<EstimateSample>,
    /// True state; only with a simulator.
    pub truth: Option<TruthSample>,
    /// Tool's origin as measured, base axes, m.
    pub tool_position: Vector3<f64>,
    /// Tool's z axis as measured, base axes.
    pub tool_z: Vector3<f64>,
    /// Measured pressing force along the normal in use, N; `None` without a usable wrench.
    pub force_n: Option<f64>,
    /// Reference of the pressing force, N.
    pub force_reference_n: f64,
    /// Whether the tool is in contact according to the controller.
    pub in_contact: bool,
    /// Reference position of the tool on the path, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Distance of the tool from the reference in the tangent plane, m.
    pub path_error_m: f64,
    /// Largest joint speed, rad/s.
    pub joint_speed_rad_per_s: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Energy in the motion tank, J; `None` if the law has no such tank.
    pub motion_tank_j: Option<f64>,
    /// Energy in the force tank, J; `None` if the law has no such tank.
    pub force_tank_j: Option<f64>,
}

impl CycleSample {
    /// Whether the tool is in contact: by the true state if it is known, otherwise by the
    /// controller.
    pub(crate) fn touches(&self) -> bool {
        self.truth.map_or(self.in_contact, |t| t.in_contact)
    }

    /// Whether the tool leaves the surface, or has left it.
    pub(crate) fn is_after_pressing(&self) -> bool {
        matches!(self.phase, Phase::Retract | Phase::Done)
    }

    /// Pressing force, N: the true one if it is known, otherwise the measured one; `None` if
    /// neither is.
    pub fn pressing_n(&self) -> Option<f64> {
        self.truth.map_or(self.force_n, |t| Some(t.force_n))
    }
}

/// Output of the estimator in use in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimateSample {
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Covariance of the normal, base axes, rad².
    pub covariance: Matrix3<f64>,
    /// Whether the estimator reports it as valid.
    pub valid: bool,
}

/// True state in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// The tool's true z axis, base axes.
    pub tool_z: Vector3<f64>,
    /// Whether any point of the pad carries load.
    pub in_contact: bool,
    /// Pressing force along the true normal, N.
    pub force_n: f64,
}
