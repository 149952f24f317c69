//! What every surface-normal estimator is: samples in, one estimate out.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, Wrench};
use tangent_sensing::{BaseMotion, Validity};

/// One control cycle as an estimator sees it.
#[derive(Clone, Copy, Debug)]
pub struct ContactSample {
    /// Time of measurement, s, on any clock that does not jump.
    pub time_s: f64,
    /// Time since the previous sample, s.
    pub dt_s: f64,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Measured tool velocity: of the tool's origin, in base axes.
    pub twist: Twist<Aligned<Tool, Base>>,
    /// Velocity the controller asked for; only the papers' own variants use it.
    pub twist_commanded: Twist<Aligned<Tool, Base>>,
    /// Conditioned wrench: what the environment does to the tool.
    pub wrench: Wrench<Tool>,
    /// Delay of the wrench's filter, s: estimators put the same lag on the velocity.
    pub wrench_delay_s: f64,
    /// Whether `wrench` can be used.
    pub wrench_validity: Validity,
    /// Age of the sensor's tare, s; `None` while there was none. A new tare makes an estimator
    /// forget the old bias.
    pub wrench_bias_age_s: Option<f64>,
    /// How the base moves at the time of the sample; `None` where it stands for good.
    pub base: Option<BaseMotion>,
}

/// Where the surface faces, and how sure that is.
#[derive(Clone, Copy, Debug)]
pub struct NormalEstimate {
    /// Contact point, base axes, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Covariance of `normal`, rad², base axes; singular along the normal itself.
    pub covariance: Matrix3<f64>,
    /// Whether to use it.
    pub validity: Validity,
    /// Coulomb friction coefficient; NaN-free: `None` while unknown.
    pub friction: Option<f64>,
    /// Shape operator: moving by `dp` on the surface turns the normal by `curvature * dp`. Base
    /// axes, 1/m, symmetric, zero along the normal; positive eigenvalues for a convex body.
    pub curvature: Option<Matrix3<f64>>,
}

impl NormalEstimate {
    /// An estimate that says only why there is none; the normal falls back to `-z_tool` (Tugal et
    /// al., IV.B.d).
    pub fn invalid(base_from_tool: &Pose<Base, Tool>, validity: Validity) -> Self {
        Self {
            point: base_from_tool.translation(),
            normal: -base_from_tool.z_axis(),
            covariance: Matrix3::identity(),
            validity,
            friction: None,
            curvature: None,
        }
    }

    /// As [`NormalEstimate::invalid`], but finite whatever the pose holds.
    pub(crate) fn refused(base_from_tool: &Pose<Base, Tool>, validity: Validity) -> Self {
        let usable = Self::invalid(base_from_tool, validity);
        let sound =
            usable.point.iter().all(|x| x.abs() < 1e6) && (usable.normal.norm() - 1.0).abs() < 1e-6;
        if sound {
            usable
        } else {
            Self::invalid(&Pose::identity(), validity)
        }
    }
}

/// A surface-normal estimator. One call per control cycle; no clock, no allocation after
/// construction.
pub trait NormalEstimator: Send {
    /// Name as in `estimate/NAME/normal`.
    fn name(&self) -> &'static str;

    /// Takes one cycle's sample and returns the estimate at its time.
    fn update(&mut self, sample: &ContactSample) -> NormalEstimate;

    /// Forgets everything learnt; called when a task starts.
    fn reset(&mut self);
}
