//! Settings of the estimators: sensors, tool, and expected surfaces.
//!
//! One `EstimatorConfig` serves every estimator of the registry; each estimator reads the sections
//! that it needs.

use serde::{Deserialize, Serialize};
use tangent_mechanics::Tip;

use crate::EstimationError;
use crate::ranges::check_ranges;

/// Settings of all estimators; every section and key may be left out.
///
/// ```
/// use tangent_estimation::EstimatorConfig;
///
/// let mut config: EstimatorConfig = toml::from_str("sensing.force_noise_n = 0.1")?;
/// config.check()?;
/// // What is left out keeps its default.
/// assert_eq!(config.contact, EstimatorConfig::default().contact);
///
/// config.surface.friction_sd = -1.0;
/// let error = config.check().unwrap_err();
/// assert!(error.to_string().contains("surface.friction_sd"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// Accuracy of the measurements, on which the covariances are based.
    pub sensing: SensingConfig,
    /// Thresholds of contact and sliding, and the tool's tip.
    pub contact: ContactConfig,
    /// Expected surfaces and friction.
    pub surface: SurfaceConfig,
    /// Sliding-window fit.
    pub quadratic: QuadraticConfig,
    /// Spatial memory of normals.
    pub gaussian_process: GaussianProcessConfig,
    /// Fusion of reactive estimate and prediction.
    pub blend: BlendConfig,
    /// Settings of the published forms, `*_paper`.
    pub paper: PaperConfig,
}

/// Accuracy of the measurements, one standard deviation per axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensingConfig {
    /// Noise of the conditioned force, N.
    pub force_noise_n: f64,
    /// Force bias just after the tare, N.
    pub force_bias_sd_n: f64,
    /// Random walk of that bias, N per root second.
    pub force_bias_drift_n_per_sqrt_s: f64,
    /// Error of the compensated payload weight, N. It shows when the tool turns away from its
    /// orientation at the tare.
    pub payload_error_n: f64,
    /// Direction of gravity, base axes; any length but zero.
    pub gravity_direction_in_base: [f64; 3],
    /// Error of the torque at the tip, bias and noise combined, Nm. Noise of the force is noise of
    /// this torque, with the distance from the sensor to the tip as its lever.
    pub torque_sd_nm: f64,
    /// Error of the velocity along the surface, m/s: kinematics, and a tool that yields.
    pub velocity_sd_m_per_s: f64,
    /// Error of the tool's height over the surface, m: roughness, seams, ripple of the gears.
    pub height_sd_m: f64,
    /// Rotation of the sensor's and the tip's true axes against those stated, rad: tilts every
    /// force alike.
    pub rotation_sd_rad: f64,
    /// Compliance of tool, wrist and surface along the normal, m/N: a change of force causes a
    /// motion across the surface.
    pub compliance_m_per_n: f64,
}

impl Default for SensingConfig {
    fn default() -> Self {
        Self {
            force_noise_n: 0.03,
            force_bias_sd_n: 0.05,
            force_bias_drift_n_per_sqrt_s: 0.03,
            payload_error_n: 0.2,
            gravity_direction_in_base: [0.0, 0.0, -1.0],
            torque_sd_nm: 0.015,
            velocity_sd_m_per_s: 0.0004,
            height_sd_m: 2e-5,
            rotation_sd_rad: 0.01,
            compliance_m_per_n: 2e-4,
        }
    }
}

impl SensingConfig {
    /// Simulated sensors without bias, noise or payload error.
    pub fn ideal() -> Self {
        Self {
            force_noise_n: 0.003,
            force_bias_sd_n: 0.0,
            force_bias_drift_n_per_sqrt_s: 0.0,
            payload_error_n: 0.0,
            torque_sd_nm: 0.001,
            velocity_sd_m_per_s: 0.00002,
            height_sd_m: 5e-6,
            rotation_sd_rad: 0.0,
            ..Self::default()
        }
    }
}

/// Thresholds of contact and sliding, and the tool's tip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactConfig {
    /// Pressing force above which contact begins, N.
    pub force_on_n: f64,
    /// Pressing force below which contact ends, N.
    pub force_off_n: f64,
    /// Speed below which the direction of sliding is undefined, m/s.
    pub sliding_speed_min_m_per_s: f64,
    /// Sliding distance after a stop or turn until the direction of friction has followed, m.
    pub presliding_distance_m: f64,
    /// Expected angle between tool and surface at touchdown, rad, one standard deviation per axis.
    pub approach_misalignment_sd_rad: f64,
    /// Shape of the tool's tip: where it touches, and what the torque says of its tilt.
    pub tip: Tip,
    /// Distance travelled without contact after which the old normal is discarded, m.
    pub memory_distance_m: f64,
    /// Standard deviation of the normal above which it is not usable, rad.
    pub normal_sd_max_rad: f64,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            force_on_n: 0.6,
            force_off_n: 0.3,
            sliding_speed_min_m_per_s: 0.002,
            presliding_distance_m: 0.0005,
            approach_misalignment_sd_rad: 0.15,
            tip: Tip::Unknown,
            memory_distance_m: 0.02,
            normal_sd_max_rad: 0.6,
        }
    }
}

/// Expected surfaces and friction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceConfig {
    /// Expected curvature, 1/m, one standard deviation.
    pub curvature_sd_per_m: f64,
    /// Rate of change of curvature along the path, 1/m per root metre.
    pub curvature_change_per_m_per_sqrt_m: f64,
    /// Rotation of the normal that curvature does not explain (waviness), rad per root metre.
    pub waviness_rad_per_sqrt_m: f64,
    /// Expected friction coefficient before any sliding.
    pub friction_initial: f64,
    /// Standard deviation of the expected friction coefficient.
    pub friction_sd: f64,
    /// Rate of change of friction along the path, per root metre: determines how fast old values
    /// are forgotten.
    pub friction_change_per_sqrt_m: f64,
    /// Upper bound of the friction coefficient.
    pub friction_max: f64,
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            curvature_sd_per_m: 4.0,
            curvature_change_per_m_per_sqrt_m: 10.0,
            waviness_rad_per_sqrt_m: 0.015,
            friction_initial: 0.3,
            friction_sd: 0.2,
            friction_change_per_sqrt_m: 0.15,
            friction_max: 1.5,
        }
    }
}

/// Sliding-window fit of `quadratic`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QuadraticConfig {
    /// Distance between stored contact points, m.
    pub spacing_m: f64,
    /// Stored points further than this from the current one are ignored, m.
    pub radius_m: f64,
    /// Height error of one stored point, m.
    pub height_sd_m: f64,
    /// Distance over which height errors of neighbouring points are correlated, m.
    pub height_correlation_m: f64,
}

impl Default for QuadraticConfig {
    fn default() -> Self {
        Self {
            spacing_m: 0.0005,
            radius_m: 0.02,
            height_sd_m: 5e-5,
            height_correlation_m: 0.002,
        }
    }
}

/// Spatial memory of `gaussian_process`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GaussianProcessConfig {
    /// Length scale of the squared-exponential kernel, m.
    pub length_m: f64,
    /// Standard deviation of the normal around the neighbourhood's mean, rad.
    pub amplitude_rad: f64,
    /// Distance between stored samples, m; a nearer sample updates the stored one.
    pub spacing_m: f64,
    /// Look-ahead distance per speed, s.
    pub look_ahead_s: f64,
    /// Upper bound of the look-ahead distance, m.
    pub look_ahead_max_m: f64,
    /// Independent error of one stored normal, rad.
    pub noise_rad: f64,
}

impl Default for GaussianProcessConfig {
    fn default() -> Self {
        Self {
            length_m: 0.04,
            amplitude_rad: 0.3,
            spacing_m: 0.002,
            look_ahead_s: 0.03,
            look_ahead_max_m: 0.003,
            noise_rad: 0.003,
        }
    }
}

/// Fusion of `blend`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BlendConfig {
    /// Smallest weight of the prediction, if there is one.
    pub alpha_min: f64,
    /// Largest weight of the prediction.
    pub alpha_max: f64,
}

impl Default for BlendConfig {
    fn default() -> Self {
        Self {
            alpha_min: 0.05,
            alpha_max: 0.95,
        }
    }
}

/// Settings of the published forms; the paper states no values for them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperConfig {
    /// Weight of the newest sample in the moving average of friction.
    pub friction_weight: f64,
    /// Number of contact points in the window of the quadratic fit, at most 64.
    pub window_points: usize,
    /// Distance between the contact points of the quadratic fit, m.
    pub spacing_m: f64,
    /// Length scale of the kernel, m.
    pub length_m: f64,
    /// Look-ahead distance per speed, s.
    pub look_ahead_s: f64,
    /// Upper bound of the look-ahead distance, m.
    pub look_ahead_max_m: f64,
    /// Weight of the prediction in the blend (IV.B.d).
    pub alpha: f64,
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self {
            friction_weight: 0.05,
            window_points: 50,
            spacing_m: 0.0005,
            length_m: 0.01,
            look_ahead_s: 0.1,
            look_ahead_max_m: 0.005,
            alpha: 0.5,
        }
    }
}

impl EstimatorConfig {
    /// Rejects values that no estimator can work with.
    ///
    /// # Errors
    /// [`EstimationError::OutOfRange`] names the key, the value and what is allowed.
    pub fn check(&self) -> Result<(), EstimationError> {
        let (s, c, f) = (&self.sensing, &self.contact, &self.surface);
        let (q, g, p) = (&self.quadratic, &self.gaussian_process, &self.paper);
        let positive = 1e-9;
        let [gx, gy, gz] = s.gravity_direction_in_base;
        let gravity = gx.hypot(gy).hypot(gz);
        check_ranges(&[
            ("sensing.force_noise_n", s.force_noise_n, positive, 100.0),
            ("sensing.force_bias_sd_n", s.force_bias_sd_n, 0.0, 100.0),
            (
                "sensing.force_bias_drift_n_per_sqrt_s",
                s.force_bias_drift_n_per_sqrt_s,
                0.0,
                10.0,
            ),
            ("sensing.payload_error_n", s.payload_error_n, 0.0, 100.0),
            ("sensing.gravity_direction_in_base", gravity, 1e-3, 1e3),
            ("sensing.torque_sd_nm", s.torque_sd_nm, positive, 100.0),
            (
                "sensing.velocity_sd_m_per_s",
                s.velocity_sd_m_per_s,
                positive,
                1.0,
            ),
            ("sensing.height_sd_m", s.height_sd_m, 1e-8, 0.01),
            ("sensing.rotation_sd_rad", s.rotation_sd_rad, 0.0, 0.5),
            ("sensing.compliance_m_per_n", s.compliance_m_per_n, 0.0, 0.1),
            ("contact.force_on_n", c.force_on_n, 0.01, 1000.0),
            ("contact.force_off_n", c.force_off_n, 0.0, c.force_on_n),
            (
                "contact.sliding_speed_min_m_per_s",
                c.sliding_speed_min_m_per_s,
                1e-5,
                1.0,
            ),
            (
                "contact.presliding_distance_m",
                c.presliding_distance_m,
                0.0,
                0.1,
            ),
            (
                "contact.approach_misalignment_sd_rad",
                c.approach_misalignment_sd_rad,
                1e-3,
                1.0,
            ),
            (
                "contact.tip.radius_m",
                c.tip.radius_m().unwrap_or(0.0),
                0.0,
                Tip::RADIUS_MAX_M,
            ),
            ("contact.memory_distance_m", c.memory_distance_m, 0.0, 1.0),
            (
                "contact.normal_sd_max_rad",
                c.normal_sd_max_rad,
                c.approach_misalignment_sd_rad,
                2.0,
            ),
            (
                "surface.curvature_sd_per_m",
                f.curvature_sd_per_m,
                0.0,
                1000.0,
            ),
            (
                "surface.curvature_change_per_m_per_sqrt_m",
                f.curvature_change_per_m_per_sqrt_m,
                0.0,
                1e4,
            ),
            (
                "surface.waviness_rad_per_sqrt_m",
                f.waviness_rad_per_sqrt_m,
                0.0,
                10.0,
            ),
            (
                "surface.friction_initial",
                f.friction_initial,
                0.0,
                f.friction_max,
            ),
            ("surface.friction_sd", f.friction_sd, 0.0, 2.0),
            (
                "surface.friction_change_per_sqrt_m",
                f.friction_change_per_sqrt_m,
                0.0,
                100.0,
            ),
            ("surface.friction_max", f.friction_max, 0.1, 5.0),
            ("quadratic.spacing_m", q.spacing_m, 1e-5, 0.1),
            ("quadratic.radius_m", q.radius_m, 4.0 * q.spacing_m, 1.0),
            ("quadratic.height_sd_m", q.height_sd_m, 1e-7, 0.1),
            (
                "quadratic.height_correlation_m",
                q.height_correlation_m,
                0.0,
                0.1,
            ),
            ("gaussian_process.length_m", g.length_m, 1e-4, 10.0),
            ("gaussian_process.amplitude_rad", g.amplitude_rad, 1e-3, 3.0),
            ("gaussian_process.spacing_m", g.spacing_m, 1e-5, g.length_m),
            ("gaussian_process.look_ahead_s", g.look_ahead_s, 0.0, 5.0),
            (
                "gaussian_process.look_ahead_max_m",
                g.look_ahead_max_m,
                0.0,
                g.length_m,
            ),
            ("gaussian_process.noise_rad", g.noise_rad, 1e-4, 1.0),
            (
                "blend.alpha_min",
                self.blend.alpha_min,
                0.0,
                self.blend.alpha_max,
            ),
            ("blend.alpha_max", self.blend.alpha_max, 0.0, 1.0),
            ("paper.friction_weight", p.friction_weight, 1e-6, 1.0),
            ("paper.window_points", p.window_points as f64, 6.0, 64.0),
            ("paper.spacing_m", p.spacing_m, 0.0, 0.1),
            ("paper.length_m", p.length_m, 1e-4, 10.0),
            ("paper.look_ahead_s", p.look_ahead_s, 0.0, 5.0),
            ("paper.look_ahead_max_m", p.look_ahead_max_m, 0.0, 1.0),
            ("paper.alpha", p.alpha, 0.0, 1.0),
        ])
    }
}
