//! `gaussian_process_paper`: kernel-weighted mean of normals at a look-ahead point, then a constant
//! blend, as published (Tugal et al., IV.B.c and d).
//!
//! It has no predictive variance: far from all samples, its covariance is the same as near them.
//! Created by the registry, for comparison in the tables.

use nalgebra::Vector3;
use tangent_mechanics::Direction;
use tangent_sensing::Validity;

use crate::EstimatorConfig;
use crate::reactive_paper::{ReactivePaper, published_covariance};
use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};

const CAPACITY: usize = 256;

/// The published prediction, "Adt. C.+GPR" in Tables 2 and 3.
#[derive(Clone, Debug)]
pub(crate) struct GaussianProcessPaper {
    config: EstimatorConfig,
    reactive: ReactivePaper,
    stored: Vec<(Vector3<f64>, Vector3<f64>)>,
    oldest: usize,
}

impl GaussianProcessPaper {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            reactive: ReactivePaper::new(config),
            stored: Vec::with_capacity(CAPACITY),
            oldest: 0,
        }
    }

    fn remember(&mut self, point: Vector3<f64>, normal: Vector3<f64>) {
        if self.stored.len() < CAPACITY {
            self.stored.push((point, normal));
        } else {
            self.stored[self.oldest] = (point, normal);
            self.oldest = (self.oldest + 1) % CAPACITY;
        }
    }

    /// Nadaraya-Watson mean at a point; `None` where all weights vanish.
    fn predict(&self, ahead: &Vector3<f64>) -> Option<Vector3<f64>> {
        let length2 = self.config.paper.length_m.powi(2);
        let sum: Vector3<f64> = self
            .stored
            .iter()
            .map(|(p, n)| n * (-(p - ahead).norm_squared() / (2.0 * length2)).exp())
            .sum();
        sum.try_normalize(1e-12)
    }
}

impl WorldEstimator for GaussianProcessPaper {
    fn name(&self) -> &'static str {
        "gaussian_process_paper"
    }

    fn update(&mut self, sample: &WorldSample) -> WorldEstimate {
        let step = self.reactive.step(sample);
        let mut estimate = step.estimate;
        let Some((motion, velocity)) = step.contact else {
            if estimate.validity == Validity::NoContact {
                self.stored.clear();
                self.oldest = 0;
            }
            return estimate;
        };
        let p = self.config.paper;
        let speed = velocity.norm();
        let ahead = if speed > 1e-4 {
            let distance = (p.look_ahead_s * speed).min(p.look_ahead_max_m);
            motion.point + velocity * (distance / speed)
        } else {
            motion.point
        };
        let prediction = self.predict(&ahead);
        self.remember(motion.point, estimate.normal_vector());
        if let Some(predicted) = prediction {
            let mixed = estimate.normal_vector() * (1.0 - p.alpha) + predicted * p.alpha;
            if let Some(normal) = mixed.try_normalize(1e-9) {
                estimate.normal = Direction::new(normal);
                estimate = published_covariance(estimate);
            }
        }
        self.reactive.hold(estimate);
        estimate
    }

    fn reset(&mut self) {
        *self = Self::new(&self.config);
    }
}
