//! `quadratic_paper`: `z = ax² + by² + cxy + dx + ey + f` in base axes, as published (Tugal et al.,
//! IV.B.b).
//!
//! Fragile on steep surfaces, where z is no function of x and y: reported as degenerate where the
//! fit is singular, wrong without a word where it is only bad. Along a single straight stroke,
//! which leaves a slope open, the published text says nothing; the reactive normal stands in.
//! Called by the registry, for the tables.

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector3};
use tangent_sensing::Validity;

use crate::reactive_paper::{ReactivePaper, published_covariance};
use crate::{ContactSample, EstimatorConfig, NormalEstimate, NormalEstimator};

const CAPACITY: usize = 64;
/// Spread below which there is nothing to fit yet, m.
const SPREAD_MIN_M: f64 = 0.008;
/// Width over length of the window below which it is a single stroke.
const STROKE_WIDTH: f64 = 0.1;
/// Horizontal width over length of the window below which z is no function of x and y.
const STEEP: f64 = 0.02;

/// The published refinement, "Adt. C.+Quadratic" in Tables 2 and 3.
#[derive(Clone, Debug)]
pub struct QuadraticPaper {
    config: EstimatorConfig,
    reactive: ReactivePaper,
    points: [Vector3<f64>; CAPACITY],
    count: usize,
    next: usize,
}

enum Fit {
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

    fn fit(&self, point: &Vector3<f64>) -> Fit {
        let points = &self.points[..self.count];
        let spread = points
            .iter()
            .map(|p| (p - point).norm())
            .fold(0.0, f64::max);
        if self.count < 6 || spread < SPREAD_MIN_M {
            return Fit::TooEarly;
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
        // A single stroke: the slope across it is anybody's guess, and least squares would guess
        // from noise.
        if extents[1] < STROKE_WIDTH.powi(2) * extents[2] {
            return Fit::TooEarly;
        }
        let flat = scatter.fixed_view::<2, 2>(0, 0).into_owned();
        if flat.symmetric_eigenvalues().min() < STEEP.powi(2) * extents[2] {
            return Fit::Singular;
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
        // Least norm where the points leave a coefficient open.
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
            Some(n) if n.iter().all(|x| x.is_finite()) => Fit::Normal(n),
            _ => Fit::Singular,
        }
    }
}

impl NormalEstimator for QuadraticPaper {
    fn name(&self) -> &'static str {
        "quadratic_paper"
    }

    fn update(&mut self, sample: &ContactSample) -> NormalEstimate {
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
            Fit::TooEarly => {}
            Fit::Singular => estimate.validity = Validity::Degenerate,
            Fit::Normal(n) => {
                // The gradient has two signs; the reactive normal says which one leaves the
                // material.
                estimate.normal = if n.dot(&estimate.normal) < 0.0 { -n } else { n };
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
