//! `reactive_paper`: force-velocity decomposition exactly as published (Tugal et al., IV.B.a).
//!
//! It uses the commanded velocity, does not match the lag of the wrench, has no bias state, and
//! reports a constant covariance. It serves for comparison in the tables. Created by the registry
//! and by the other published forms.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Direction, Point};
use tangent_sensing::Validity;

use crate::EstimatorConfig;
use crate::motion::{Motion, MotionTracker, free_space};
use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};

/// Speed below which the published projection is singular, m/s. Only the force is used then.
const SPEED_MIN_M_PER_S: f64 = 1e-4;

/// The published baseline, "Adt. C." in Tables 2 and 3.
#[derive(Clone, Debug)]
pub(crate) struct ReactivePaper {
    config: EstimatorConfig,
    tracker: MotionTracker,
    friction: Option<f64>,
    touching: bool,
    held: Option<WorldEstimate>,
}

/// Result of one step, for the estimators that refine it.
pub(crate) struct PaperStep {
    pub estimate: WorldEstimate,
    /// Motion and commanded velocity (world axes, m/s); only in contact.
    pub contact: Option<(Motion, Vector3<f64>)>,
}

impl ReactivePaper {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            tracker: MotionTracker::default(),
            friction: None,
            touching: false,
            held: None,
        }
    }

    pub(crate) fn step(&mut self, sample: &WorldSample) -> PaperStep {
        let taken = if sample.twist_commanded.linear.iter().all(|x| x.abs() < 1e6) {
            self.tracker.take(sample)
        } else {
            Err(Validity::NotFinite)
        };
        let motion = match taken {
            Ok(motion) => motion,
            Err(validity) => {
                let mut estimate = self
                    .held
                    .unwrap_or_else(|| WorldEstimate::invalid(&sample.world_from_tool, validity));
                estimate.validity = validity;
                return PaperStep {
                    estimate,
                    contact: None,
                };
            }
        };
        let c = &self.config.contact;
        let threshold = if self.touching {
            c.force_off_n
        } else {
            c.force_on_n
        };
        self.touching = -motion.force_in_tool.z >= threshold;
        if !self.touching {
            let estimate = WorldEstimate {
                friction: self.friction,
                ..free_space(&motion)
            };
            self.held = Some(estimate);
            return PaperStep {
                estimate,
                contact: None,
            };
        }
        let velocity = sample.twist_commanded.linear;
        let estimate = WorldEstimate {
            point: Point::new(motion.point),
            normal: Direction::new(self.decompose(
                &sample.world_from_tool.rotate(&motion.force_in_tool),
                &velocity,
            )),
            covariance: Matrix3::zeros(),
            validity: Validity::Valid,
            friction: self.friction,
            curvature: None,
        };
        let estimate = published_covariance(estimate);
        self.held = Some(estimate);
        PaperStep {
            estimate,
            contact: Some((motion, velocity)),
        }
    }

    fn decompose(&mut self, force: &Vector3<f64>, velocity: &Vector3<f64>) -> Vector3<f64> {
        let speed = velocity.norm();
        if speed < SPEED_MIN_M_PER_S {
            return force.normalize();
        }
        let direction = velocity / speed;
        // f_t = (I - v (v'v)^-1 v') f
        let along = force.dot(&direction);
        let across = force - direction * along;
        let across_n = across.norm();
        if across_n < 1e-9 {
            return force.normalize();
        }
        let now = (-along / across_n).clamp(0.0, self.config.surface.friction_max);
        let weight = self.config.paper.friction_weight;
        let friction = self.friction.map_or(now, |f| f + (now - f) * weight);
        self.friction = Some(friction);
        // n = (f - f_tau) / |f - f_tau|, f_tau = -mu |f_t| v / |v|
        let corrected = force + direction * (friction * across_n);
        corrected
            .try_normalize(1e-9)
            .unwrap_or_else(|| force.normalize())
    }

    pub(crate) fn hold(&mut self, estimate: WorldEstimate) {
        self.held = Some(estimate);
    }
}

/// Sets the covariance. The paper states none; five degrees per axis is the size of its own errors
/// (Table 2, RMSE 4.8).
pub(crate) fn published_covariance(mut estimate: WorldEstimate) -> WorldEstimate {
    let n = estimate.normal_vector();
    let tangent = Matrix3::identity() - n * n.transpose();
    estimate.covariance = tangent * 0.0076;
    estimate
}

impl WorldEstimator for ReactivePaper {
    fn name(&self) -> &'static str {
        "reactive_paper"
    }

    fn update(&mut self, sample: &WorldSample) -> WorldEstimate {
        self.step(sample).estimate
    }

    fn reset(&mut self) {
        *self = Self::new(&self.config);
    }
}
