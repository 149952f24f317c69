//! What an estimator is told about its sensors, its tool and the surfaces it may meet.
//!
//! One `EstimatorConfig` serves every estimator of the registry; each reads the sections that
//! concern it.

use serde::{Deserialize, Serialize};

use crate::EstimationError;

/// Settings of all estimators; every section and key may be left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// How good the measurements are: what the covariances rest on.
    pub sensing: SensingConfig,
    /// When there is contact, and when it slides.
    pub contact: ContactConfig,
    /// What surfaces and friction may be met.
    pub surface: SurfaceConfig,
    /// Sliding-window fit.
    pub quadratic: QuadraticConfig,
    /// Spatial memory.
    pub gaussian_process: GaussianProcessConfig,
    /// Fusion of reactive estimate and prediction.
    pub blend: BlendConfig,
    /// The published forms, `*_paper`.
    pub paper: PaperConfig,
}

/// How good the measurements are, one standard deviation per axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensingConfig {
    /// Noise of the conditioned force, N.
    pub force_noise_n: f64,
    /// Force bias just after the tare, N.
    pub force_bias_sd_n: f64,
    /// Random walk of that bias, N per root second.
    pub force_bias_drift_n_per_sqrt_s: f64,
    /// Weight that the payload compensation may be wrong by, N; a turn of the tool away from where
    /// it was tared brings it out.
    pub payload_error_n: f64,
    /// Where gravity points, base axes; any length but zero.
    pub gravity_direction_in_base: [f64; 3],
    /// Error of the torque at the tool, bias and noise together, Nm.
    pub torque_sd_nm: f64,
    /// Error of the velocity across the surface, m/s: kinematics, roughness and seams.
    pub velocity_sd_m_per_s: f64,
    /// Compliance of tool, wrist and surface along the normal, m/N: a force that changes is a
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
            torque_sd_nm: 0.01,
            velocity_sd_m_per_s: 0.0002,
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
            ..Self::default()
        }
    }
}

/// When there is contact, when it slides, and the tool's pad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactConfig {
    /// Pressing force above which contact begins, N.
    pub force_on_n: f64,
    /// Pressing force below which contact ends, N.
    pub force_off_n: f64,
    /// Speed below which a direction of sliding is not defined, m/s.
    pub sliding_speed_min_m_per_s: f64,
    /// Distance to slide after a stop or turn before friction has turned with it, m.
    pub presliding_distance_m: f64,
    /// Angle between tool and surface to expect at touchdown, rad, one standard deviation per axis.
    pub approach_misalignment_sd_rad: f64,
    /// Radius of the tool's pad, m: the centre of pressure is never further out.
    pub pad_radius_m: f64,
    /// Distance without contact after which the old normal is forgotten, m.
    pub memory_distance_m: f64,
    /// Standard deviation of the normal, rad, beyond which it is not to be used.
    pub normal_sd_max_rad: f64,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            force_on_n: 0.6,
            force_off_n: 0.3,
            sliding_speed_min_m_per_s: 0.002,
            presliding_distance_m: 0.001,
            approach_misalignment_sd_rad: 0.12,
            pad_radius_m: 0.01,
            memory_distance_m: 0.02,
            normal_sd_max_rad: 0.35,
        }
    }
}

/// What surfaces and friction may be met.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceConfig {
    /// Curvature to expect, 1/m, one standard deviation.
    pub curvature_sd_per_m: f64,
    /// How fast curvature changes along the path, 1/m per root metre.
    pub curvature_change_per_m_per_sqrt_m: f64,
    /// Turn of the normal that no curvature explains (waviness), rad per root metre.
    pub waviness_rad_per_sqrt_m: f64,
    /// Friction coefficient to expect before any sliding.
    pub friction_initial: f64,
    /// Its standard deviation.
    pub friction_sd: f64,
    /// How fast friction changes along the path, per root metre: what forgetting by distance means.
    pub friction_change_per_sqrt_m: f64,
    /// Largest friction coefficient to believe.
    pub friction_max: f64,
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            curvature_sd_per_m: 4.0,
            curvature_change_per_m_per_sqrt_m: 4.0,
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
    /// Points further than this from the present one do not count, m.
    pub radius_m: f64,
    /// Height error of one stored point, m.
    pub height_sd_m: f64,
    /// Distance over which height errors of neighbouring points are alike, m.
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
    /// Distance between stored samples, m; a nearer one refreshes the stored one.
    pub spacing_m: f64,
    /// Look-ahead per speed, s.
    pub look_ahead_s: f64,
    /// Bound of the look-ahead, m.
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
    /// Smallest weight of the prediction where there is one.
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

/// The published forms; the paper gives no numbers for these.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperConfig {
    /// Weight of the newest sample in the moving average of friction.
    pub friction_weight: f64,
    /// Contact points in the window of the quadratic fit, at most 64.
    pub window_points: usize,
    /// Distance between its contact points, m.
    pub spacing_m: f64,
    /// Kernel length, m.
    pub length_m: f64,
    /// Look-ahead per speed, s.
    pub look_ahead_s: f64,
    /// Bound of the look-ahead, m.
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
    /// Refuses values that no estimator can work with.
    ///
    /// # Errors
    /// [`EstimationError::OutOfRange`] names the key, the value and what is allowed.
    pub fn check(&self) -> Result<(), EstimationError> {
        let (s, c, f) = (&self.sensing, &self.contact, &self.surface);
        let (q, g, p) = (&self.quadratic, &self.gaussian_process, &self.paper);
        let positive = 1e-9;
        let [gx, gy, gz] = s.gravity_direction_in_base;
        let gravity = gx.hypot(gy).hypot(gz);
        let rows = [
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
            ("contact.pad_radius_m", c.pad_radius_m, 0.0, 0.5),
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
        ];
        for (key, value, lower, upper) in rows {
            // A NaN must fail too, so the comparison is for being inside.
            let inside = value >= lower && value <= upper;
            if !inside {
                return Err(EstimationError::OutOfRange {
                    key,
                    value,
                    lower,
                    upper,
                });
            }
        }
        Ok(())
    }
}
