//! `quadratic`: a quadratic surface through the recent contact points, in the tangent frame of the
//! present normal (Tugal et al., IV.B.b).
//!
//! The published fit is of `z(x, y)` in base axes and without regularisation. Here the reactive
//! estimate determines the slope where the points do not, as across a single straight stroke.
//! Created by the registry.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};
use tangent_mechanics::Direction;

use crate::EstimatorConfig;
use crate::contact_filter::ContactPhase;
use crate::motion::Motion;
use crate::reactive::Reactive;
use crate::tangent_frame::TangentFrame;
use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};

const CAPACITY: usize = 128;
type Coefficients = SVector<f64, 6>;

/// Sliding-window fit, regularised by the reactive estimate.
#[derive(Clone, Debug)]
pub(crate) struct Quadratic {
    config: EstimatorConfig,
    reactive: Reactive,
    points: [Touch; CAPACITY],
    count: usize,
    next: usize,
    height_variance_m2: f64,
}

/// Contact point (world axes, m), and its variance along the normal besides the common height
/// error.
#[derive(Clone, Copy, Debug)]
struct Touch {
    point: Vector3<f64>,
    variance_m2: f64,
}

/// Slope and shape at the tool's origin, tangent axes of the frame they were fitted in.
struct TangentFit {
    turn: Vector2<f64>,
    covariance: Matrix2<f64>,
    shape: Matrix2<f64>,
}

impl Quadratic {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            reactive: Reactive::new(config),
            points: [Touch {
                point: Vector3::zeros(),
                variance_m2: 0.0,
            }; CAPACITY],
            count: 0,
            next: 0,
            height_variance_m2: config.quadratic.height_sd_m.powi(2),
        }
    }

    fn newest(&self) -> Option<&Touch> {
        (self.count > 0).then(|| &self.points[(self.next + CAPACITY - 1) % CAPACITY])
    }

    fn store(&mut self, motion: &Motion) {
        let contact = self.reactive.state();
        let give = self.config.sensing.compliance_m_per_n * contact.force_n();
        let point = motion.point_lagged + contact.centre() + contact.frame().normal * give;
        let spacing = self.config.quadratic.spacing_m;
        if self
            .newest()
            .is_some_and(|t| (point - t.point).norm() < spacing)
        {
            return;
        }
        // A tilted tool touches beside its origin, at a distance that is not exactly known.
        let tilt = contact.frame().project(&motion.rotation.column(2).into());
        self.points[self.next] = Touch {
            point,
            variance_m2: tilt.norm_squared() * contact.centre_sd_m().powi(2),
        };
        self.next = (self.next + 1) % CAPACITY;
        self.count = (self.count + 1).min(CAPACITY);
    }

    /// Least squares in the frame, around the tool's origin.
    /// `z = -(k11 x² + k22 y²)/2 - k12 x y + d x + e y + f`.
    fn fit(
        &mut self,
        motion: &Motion,
        frame: &TangentFrame,
        prior: &Matrix2<f64>,
    ) -> Option<TangentFit> {
        let q = &self.config.quadratic;
        let alike = (q.height_correlation_m / q.spacing_m).max(1.0);
        let common = self.height_variance_m2;
        let mut information = SMatrix::<f64, 6, 6>::zeros();
        let mut right = Coefficients::zeros();
        let mut rows = 0;
        let local = |t: &Touch| {
            let r = t.point - motion.point_lagged;
            let xy = frame.project(&r);
            (xy.norm_squared() <= q.radius_m * q.radius_m).then(|| {
                let row = Coefficients::new(
                    -0.5 * xy.x * xy.x,
                    -0.5 * xy.y * xy.y,
                    -xy.x * xy.y,
                    xy.x,
                    xy.y,
                    1.0,
                );
                (row, frame.normal.dot(&r), t.variance_m2)
            })
        };
        for (row, height, own) in self.points[..self.count].iter().filter_map(local) {
            let weight = 1.0 / ((common + own) * alike);
            information.syger(weight, &row, &row, 1.0);
            right.axpy(weight * height, &row, 1.0);
            rows += 1;
        }
        if rows < 6 {
            return None;
        }
        let curvature = 1.0 / self.config.surface.curvature_sd_per_m.max(1e-3).powi(2);
        information[(0, 0)] += curvature;
        information[(1, 1)] += curvature;
        information[(2, 2)] += 2.0 * curvature;
        // The height itself is not used; a standard deviation of one metre keeps the matrix
        // regular.
        information[(5, 5)] += 1.0;
        let slope = prior.try_inverse()?;
        for (i, j) in [(0, 0), (1, 0), (1, 1)] {
            information[(3 + i, 3 + j)] += slope[(i, j)];
        }
        information.fill_upper_triangle_with_lower_triangle();
        let cholesky = information.cholesky()?;
        let solution = cholesky.solve(&right);
        let mut residual = 0.0;
        for (row, height, _) in self.points[..self.count].iter().filter_map(local) {
            residual += (height - row.dot(&solution)).powi(2);
        }
        // The deviation of the surface from a quadratic counts as height error in the next cycles.
        let floor = q.height_sd_m * q.height_sd_m;
        let found = (residual / f64::from(rows)).max(floor);
        self.height_variance_m2 += 0.05 * (found - self.height_variance_m2);
        let covariance = cholesky.inverse().fixed_view::<2, 2>(3, 3).into_owned();
        let shape = Matrix2::new(solution[0], solution[2], solution[2], solution[1]);
        // The error of the torque shifts all points alike, so it does not average out.
        let centre_sd_m = self.reactive.state().centre_sd_m();
        Some(TangentFit {
            turn: Vector2::new(-solution[3], -solution[4]),
            covariance: covariance + shape * shape * centre_sd_m.powi(2),
            shape,
        })
    }

    fn refine(&mut self, motion: &Motion, base: &WorldEstimate) -> WorldEstimate {
        let contact = self.reactive.state();
        let frame = *contact.frame();
        let mut prior = self.reactive.normal_covariance();
        // Along the stroke, the reactive estimate was made from the same motion as the points, so
        // it counts only half.
        let t = frame.project(&contact.slide_direction());
        prior += t * t.transpose() * (t.dot(&(prior * t)));
        let Some(fit) = self.fit(motion, &frame, &prior) else {
            return *base;
        };
        let since = frame.project(&(motion.point - motion.point_lagged));
        let now = frame.turned(&(fit.turn + fit.shape * since));
        WorldEstimate {
            normal: Direction::new(now.normal),
            covariance: now.lift_matrix(&fit.covariance),
            curvature: Some(now.lift_matrix(&fit.shape)),
            ..*base
        }
    }
}

impl WorldEstimator for Quadratic {
    fn name(&self) -> &'static str {
        "quadratic"
    }

    fn update(&mut self, sample: &WorldSample) -> WorldEstimate {
        let (base, motion) = self.reactive.step(sample);
        let Some(motion) = motion else {
            return base;
        };
        match self.reactive.state().phase() {
            ContactPhase::Free => {
                self.count = 0;
                self.next = 0;
                return base;
            }
            ContactPhase::Pressing => {}
            ContactPhase::Sliding => self.store(&motion),
        }
        let estimate = self.refine(&motion, &base);
        self.reactive.hold(estimate);
        estimate
    }

    fn reset(&mut self) {
        *self = Self::new(&self.config);
    }
}
