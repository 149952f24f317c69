//! `gaussian_process`: spatial memory of normals, evaluated at a point ahead of the tool (Tugal et
//! al., IV.B.c).
//!
//! The published form is a kernel-weighted mean. This is a Gaussian process with the same kernel,
//! whose predictive variance grows with the distance to the samples. Created by the registry and by
//! `blend`.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};
use tangent_mechanics::Direction;

use crate::EstimatorConfig;
use crate::contact_filter::ContactPhase;
use crate::motion::Motion;
use crate::reactive::Reactive;
use crate::tangent_frame::TangentFrame;
use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};

/// Number of stored samples.
const CAPACITY: usize = 256;
/// Number of samples that one prediction is made from: the present one and the nearest stored ones.
const LOCAL: usize = 20;

#[derive(Clone, Copy, Debug)]
struct Stored {
    point: Vector3<f64>,
    frame: TangentFrame,
    covariance: Matrix2<f64>,
}

/// Gaussian process over the contact point, on the sphere.
#[derive(Clone, Debug)]
pub(crate) struct GaussianProcess {
    config: EstimatorConfig,
    reactive: Reactive,
    stored: Vec<Stored>,
    oldest: usize,
}

impl GaussianProcess {
    /// The configuration must have passed [`EstimatorConfig::check`].
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            reactive: Reactive::new(config),
            stored: Vec::with_capacity(CAPACITY),
            oldest: 0,
        }
    }

    /// Reactive estimate, and the prediction at the look-ahead point where there is contact.
    pub(crate) fn step(&mut self, sample: &WorldSample) -> (WorldEstimate, Option<WorldEstimate>) {
        let (base, motion) = self.reactive.step(sample);
        let Some(motion) = motion else {
            return (base, None);
        };
        if self.reactive.state().phase() == ContactPhase::Free {
            return (base, None);
        }
        let prediction = self.predict(&motion, &base);
        if self.reactive.state().phase() == ContactPhase::Sliding {
            self.remember(&motion);
        }
        (base, prediction)
    }

    pub(crate) fn hold(&mut self, estimate: WorldEstimate) {
        self.reactive.hold(estimate);
    }

    /// The reactive estimate at the time of the wrench.
    fn present(&self, motion: &Motion) -> Stored {
        Stored {
            point: motion.point_lagged,
            frame: *self.reactive.state().frame(),
            covariance: self.reactive.normal_covariance(),
        }
    }

    fn remember(&mut self, motion: &Motion) {
        let sample = self.present(motion);
        let nearest = self
            .stored
            .iter_mut()
            .map(|s| ((s.point - sample.point).norm_squared(), s))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((distance2, near)) = nearest
            && distance2 < self.config.gaussian_process.spacing_m.powi(2)
        {
            let apart = near.frame.logarithm(&sample.frame.normal);
            let doubt = near.covariance.trace() + sample.covariance.trace();
            // The one with the smaller covariance stays. A sample that contradicts the stored one
            // replaces it: the surface has moved.
            if sample.covariance.trace() <= near.covariance.trace()
                || apart.norm_squared() > 16.0 * doubt
            {
                *near = sample;
            }
            return;
        }
        if self.stored.len() < CAPACITY {
            self.stored.push(sample);
        } else {
            self.stored[self.oldest] = sample;
            self.oldest = (self.oldest + 1) % CAPACITY;
        }
    }

    /// Distance to look ahead along the motion, bounded.
    fn look_ahead(&self, motion: &Motion) -> Vector3<f64> {
        let g = &self.config.gaussian_process;
        let frame = self.reactive.state().frame();
        let tangential = frame.lift(&frame.project(&motion.velocity));
        let wanted = tangential * g.look_ahead_s;
        if wanted.norm() > g.look_ahead_max_m {
            wanted * (g.look_ahead_max_m / wanted.norm())
        } else {
            wanted
        }
    }

    fn predict(&self, motion: &Motion, base: &WorldEstimate) -> Option<WorldEstimate> {
        let g = &self.config.gaussian_process;
        let ahead = motion.point + self.look_ahead(motion);
        let present = self.present(motion);

        // The nearest samples, by insertion: without allocation, and in a reproducible order.
        let mut chosen = [(f64::INFINITY, present); LOCAL];
        let mut count = 1;
        chosen[0].0 = 0.0;
        for s in &self.stored {
            let distance2 = (s.point - ahead).norm_squared();
            if distance2 > 9.0 * g.length_m * g.length_m {
                continue;
            }
            if count == LOCAL && distance2 >= chosen[LOCAL - 1].0 {
                continue;
            }
            let mut at = if count < LOCAL { count } else { LOCAL - 1 };
            while at > 1 && chosen[at - 1].0 > distance2 {
                chosen[at] = chosen[at - 1];
                at -= 1;
            }
            chosen[at] = (distance2, *s);
            count = (count + 1).min(LOCAL);
        }
        let chosen = &chosen[..count];

        // Constant mean: the direction of the neighbourhood, weighted by the samples' precision.
        let noise = |s: &Stored| g.noise_rad.powi(2) + 0.5 * s.covariance.trace();
        let sum: Vector3<f64> = chosen.iter().map(|(_, s)| s.frame.normal / noise(s)).sum();
        if sum.norm() <= 0.0 {
            return None;
        }
        let mean = TangentFrame::new(sum.normalize(), present.frame.first);

        let amplitude2 = g.amplitude_rad * g.amplitude_rad;
        let kernel = |a: &Vector3<f64>, b: &Vector3<f64>| {
            amplitude2 * (-(a - b).norm_squared() / (2.0 * g.length_m * g.length_m)).exp()
        };
        // Unused rows are those of the identity, so that they change nothing.
        let mut gram = SMatrix::<f64, LOCAL, LOCAL>::identity();
        let mut cross = SVector::<f64, LOCAL>::zeros();
        for (i, (_, a)) in chosen.iter().enumerate() {
            for (j, (_, b)) in chosen[..i].iter().enumerate() {
                let k = kernel(&a.point, &b.point);
                gram[(i, j)] = k;
                gram[(j, i)] = k;
            }
            gram[(i, i)] = amplitude2 + noise(a);
            cross[i] = kernel(&a.point, &ahead);
        }
        let cholesky = gram.cholesky()?;
        let weights = cholesky.solve(&cross);
        let mut turn = Vector2::zeros();
        let mut common = Matrix2::zeros();
        for (i, (_, s)) in chosen.iter().enumerate() {
            turn += mean.logarithm(&s.frame.normal) * weights[i];
            common += mean.project_matrix(&s.frame.lift_matrix(&s.covariance)) * weights[i].abs();
        }
        // The samples come from one filter and share its bias. Their errors do not average out, so
        // the weighted mean of their covariances is added to the process's own variance.
        let share: f64 = weights.iter().map(|w| w.abs()).sum();
        // Variance of the process for exact samples, plus their independent errors; the common
        // errors are accounted for above.
        let mut own = amplitude2 - 2.0 * cross.dot(&weights);
        for (i, (_, a)) in chosen.iter().enumerate() {
            own += weights[i] * weights[i] * (amplitude2 + g.noise_rad.powi(2));
            for j in 0..i {
                own += 2.0 * weights[i] * weights[j] * kernel(&a.point, &chosen[j].1.point);
            }
        }
        // The prediction is for a point that the tool has not reached.
        let ahead = self.reactive.state().shape() * mean.project(&self.look_ahead(motion));
        let covariance = common / share.max(1.0)
            + Matrix2::identity() * own.max(0.0)
            + ahead * ahead.transpose();
        let predicted = mean.turned(&turn);
        Some(WorldEstimate {
            normal: Direction::new(predicted.normal),
            covariance: predicted.lift_matrix(&covariance),
            curvature: base.curvature.map(|c| predicted.flatten(&c)),
            ..*base
        })
    }
}

impl WorldEstimator for GaussianProcess {
    fn name(&self) -> &'static str {
        "gaussian_process"
    }

    fn update(&mut self, sample: &WorldSample) -> WorldEstimate {
        let (base, prediction) = self.step(sample);
        let Some(estimate) = prediction else {
            return base;
        };
        self.hold(estimate);
        estimate
    }

    fn reset(&mut self) {
        *self = Self::new(&self.config);
    }
}
