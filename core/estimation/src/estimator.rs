//! Interface of every surface-normal estimator: samples in, one estimate out.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, Wrench};
use tangent_sensing::{BaseMotion, Validity};

/// Input of an estimator in one control cycle.
#[derive(Clone, Copy, Debug)]
pub struct ContactSample {
    /// Time of measurement, s, on any clock that does not jump.
    pub time_s: f64,
    /// Time since the previous sample, s.
    pub dt_s: f64,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Measured velocity of the tool's origin, base axes.
    pub twist: Twist<Aligned<Tool, Base>>,
    /// Commanded velocity; only the papers' own variants use it.
    pub twist_commanded: Twist<Aligned<Tool, Base>>,
    /// Conditioned wrench of the environment on the tool.
    pub wrench: Wrench<Tool>,
    /// Delay of the wrench's filter, s: estimators apply the same lag to the velocity.
    pub wrench_delay_s: f64,
    /// Whether `wrench` is usable.
    pub wrench_validity: Validity,
    /// Age of the sensor's tare, s; `None` before the first tare. After a new tare an estimator
    /// discards the old bias.
    pub wrench_bias_age_s: Option<f64>,
    /// Motion of the base at the time of the sample; `None` if the base is fixed.
    pub base: Option<BaseMotion>,
}

/// Surface normal at the contact point, with its covariance.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_estimation::NormalEstimate;
/// use tangent_mechanics::Pose;
/// use tangent_sensing::Validity;
///
/// // Without an estimate, the normal is against the tool's z axis.
/// let none = NormalEstimate::invalid(&Pose::identity(), Validity::Missing);
/// assert_eq!(none.normal, -Vector3::z());
/// assert_eq!(none.friction, None);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct NormalEstimate {
    /// Contact point, base axes, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Covariance of `normal`, rad², base axes; singular along the normal itself.
    pub covariance: Matrix3<f64>,
    /// Whether the estimate is usable.
    pub validity: Validity,
    /// Coulomb friction coefficient; `None` while unknown. Never NaN.
    pub friction: Option<f64>,
    /// Shape operator: moving by `dp` on the surface turns the normal by `curvature * dp`. Base
    /// axes, 1/m, symmetric, zero along the normal; positive eigenvalues for a convex body.
    pub curvature: Option<Matrix3<f64>>,
}

impl NormalEstimate {
    /// An estimate that only states why there is none. The normal falls back to `-z_tool` (Tugal et
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
}

/// A surface-normal estimator, called once per control cycle. It uses no clock and does not
/// allocate after construction.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_estimation::{ContactSample, EstimatorConfig, build, estimator_names};
/// use tangent_mechanics::{Pose, Twist, Wrench};
/// use tangent_sensing::Validity;
///
/// // A tool that points down slides along x on a horizontal plane: 3 N of pressing force, 0.9 N of
/// // friction. Every estimator finds the vertical normal.
/// let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
/// let twist = Twist::new(Vector3::new(0.02, 0.0, 0.0), Vector3::zeros());
/// for name in estimator_names() {
///     let mut estimator = build(name, &EstimatorConfig::default())?;
///     let mut step = |cycle: u32| {
///         let time_s = 0.008 * f64::from(cycle);
///         estimator.update(&ContactSample {
///             time_s,
///             dt_s: 0.008,
///             base_from_tool: Pose::new(Vector3::new(0.02 * time_s, 0.0, 0.0), down),
///             twist,
///             twist_commanded: twist,
///             wrench: Wrench::new(Vector3::new(-0.9, 0.0, -3.0), Vector3::zeros()),
///             wrench_delay_s: 0.0,
///             wrench_validity: Validity::Valid,
///             wrench_bias_age_s: Some(1.0 + time_s),
///             base: None,
///         })
///     };
///     for cycle in 0..250 {
///         step(cycle);
///     }
///     let estimate = step(250);
///     assert_eq!(estimate.validity, Validity::Valid, "{name}");
///     assert!(estimate.normal.angle(&Vector3::z()) < 0.02, "{name}");
/// }
/// # Ok::<(), tangent_estimation::EstimationError>(())
/// ```
pub trait NormalEstimator: Send {
    /// Name as in `estimate/NAME/normal`.
    fn name(&self) -> &'static str;

    /// Takes one cycle's sample and returns the estimate at its time.
    fn update(&mut self, sample: &ContactSample) -> NormalEstimate;

    /// Discards everything learnt; called when a task starts.
    fn reset(&mut self);
}
