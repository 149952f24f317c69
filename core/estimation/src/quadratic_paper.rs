//! `quadratic_paper`: `z = ax² + by² + cxy + dx + ey + f` in base axes, as published (Tugal et al.,
//! IV.B.b).
//!
//! It fails on steep surfaces, where z is no function of x and y: a singular fit is reported as
//! degenerate, an ill-conditioned one is not reported. Along a single straight stroke, which does
//! not determine the slope across it, the published text gives no rule; the reactive normal is used
//! there. Created by the registry, for comparison in the tables.

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector3};
use tangent_mechanics::Direction;
use tangent_sensing::Validity;

use crate::EstimatorConfig;
use crate::reactive_paper::{ReactivePaper, published_covariance};
use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};

const CAPACITY: usize = 64;
/// Spread below which there is nothing to fit yet, m.
const SPREAD_MIN_M: f64 = 0.008;
/// Width over length of the window below which it is a single stroke.
const STROKE_WIDTH: f64 = 0.1;
/// Horizontal width over length of the window below which z is no function of x and y.
const STEEP: f64 = 0.02;

/// The published refinement, "Adt. C.+Quadratic" in Tables 2 and 3.
#[derive(Clone, Debug)]
pub(crate) struct QuadraticPaper {
    config: EstimatorConfig,
    reactive: ReactivePaper,
    points: [Vector3<f64>; CAPACITY],
    count: usize,
    next: usize,
}

enum PaperFit {
    TooEarly,
    Singular,
    Normal(Vector3<f64>),
}

impl QuadraticPaper {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            reactive: ReactivePaper::new(config),
            points: [Vector3::zeros(); CAPACITY],
            count: 0,
            next: 0,
        }
    }

    fn store(&mut self, point: &Vector3<f64>) {
        let window = self.config.paper.window_points.min(CAPACITY);
        let newest = &self.points[(self.next + window - 1) % window];
        if self.count > 0 && (point - newest).norm() < self.config.paper.spacing_m {
            return;
        }
        self.points[self.next] = *point;
        self.next = (self.next + 1) % window;
        self.count = (self.count + 1).min(window);
    }

    fn fit(&self, point: &Vector3<f64>) -> PaperFit {
        let points = &self.points[..self.count];
        let spread = points
            .iter()
            .map(|p| (p - point).norm())
            .fold(0.0, f64::max);
        if self.count < 6 || spread < SPREAD_MIN_M {
            return PaperFit::TooEarly;
        }
        let count = points.len() as f64;
        let mean: Vector3<f64> = points.iter().sum::<Vector3<f64>>() / count;
        let scatter: Matrix3<f64> = points
            .iter()
            .map(|p| (p - mean) * (p - mean).transpose())
            .sum::<Matrix3<f64>>()
            / count;
        let mut extents = scatter.symmetric_eigenvalues();
        extents.as_mut_slice().sort_by(f64::total_cmp);
        // A single stroke does not determine the slope across it; least squares would fit noise.
        if extents[1] < STROKE_WIDTH.powi(2) * extents[2] {
            return PaperFit::TooEarly;
        }
        let flat = scatter.fixed_view::<2, 2>(0, 0).into_owned();
        if flat.symmetric_eigenvalues().min() < STEEP.powi(2) * extents[2] {
            return PaperFit::Singular;
        }
        // Around the newest point and in units of the window: the same fit, better conditioned.
        let mut normal = SMatrix::<f64, 6, 6>::zeros();
        let mut right = SVector::<f64, 6>::zeros();
        for p in points {
            let r = (p - point) / spread;
            let row = SVector::<f64, 6>::new(r.x * r.x, r.y * r.y, r.x * r.y, r.x, r.y, 1.0);
            normal += row * row.transpose();
            right += row * r.z;
        }
        // Least-norm solution where the points do not determine a coefficient.
        let eigen = SymmetricEigen::new(normal);
        let smallest = 1e-7 * eigen.eigenvalues.max();
        let mut solution = SVector::<f64, 6>::zeros();
        for (i, value) in eigen.eigenvalues.iter().enumerate() {
            if *value > smallest {
                let axis = eigen.eigenvectors.column(i);
                solution += axis * (axis.dot(&right) / value);
            }
        }
        match Vector3::new(solution[3], solution[4], -1.0).try_normalize(1e-9) {
            Some(n) if n.iter().all(|x| x.is_finite()) => PaperFit::Normal(n),
            _ => PaperFit::Singular,
        }
    }
}

impl WorldEstimator for QuadraticPaper {
    fn name(&self) -> &'static str {
        "quadratic_paper"
    }

    fn update(&mut self, sample: &WorldSample) -> WorldEstimate {
        let step = self.reactive.step(sample);
        let mut estimate = step.estimate;
        let Some((motion, _)) = step.contact else {
            if estimate.validity == Validity::NoContact {
                self.count = 0;
                self.next = 0;
            }
            return estimate;
        };
        self.store(&motion.point);
        match self.fit(&motion.point) {
            PaperFit::TooEarly => {}
            PaperFit::Singular => estimate.validity = Validity::Degenerate,
            PaperFit::Normal(n) => {
                // The fit does not determine the sign; the reactive normal points out of the
                // material.
                let inward = n.dot(&estimate.normal_vector()) < 0.0;
                estimate.normal = Direction::new(if inward { -n } else { n });
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
