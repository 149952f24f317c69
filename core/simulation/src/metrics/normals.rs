//! Figures of an estimator's normals.

use nalgebra::{Matrix3, Vector3};

use super::sample::{CycleSample, EstimateSample};
use super::span::SETTLING_LEFT_OUT_S;
use super::spread::{Spread, mean};

/// Figures of an estimator's normals, with the definitions of [`Figures`](super::Figures).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NormalFigures {
    /// [`Figures::normal_error_deg`](super::Figures::normal_error_deg).
    pub normal_error_deg: Option<Spread>,
    /// [`Figures::normal_error_settled_deg`](super::Figures::normal_error_settled_deg).
    pub normal_error_settled_deg: Option<Spread>,
    /// [`Figures::alignment_error_deg`](super::Figures::alignment_error_deg).
    pub alignment_error_deg: Option<Spread>,
    /// [`Figures::normal_nees_per_dof`](super::Figures::normal_nees_per_dof).
    pub normal_nees_per_dof: Option<f64>,
}

impl NormalFigures {
    /// Figures from the cycles of one task, in order of time, each with an estimate in place of its
    /// own. One pass and no copy: a report makes these figures of every estimator.
    pub fn of<'a>(
        cycles: impl IntoIterator<Item = (&'a CycleSample, Option<EstimateSample>)>,
    ) -> Self {
        let cycles = cycles.into_iter().skip_while(|(s, _)| !s.touches());
        let (mut errors, mut settled) = (Vec::new(), Vec::new());
        let (mut alignments, mut nees) = (Vec::new(), Vec::new());
        let mut settled_from = None;
        for (sample, estimate) in cycles.take_while(|(s, _)| !s.is_after_pressing()) {
            let from = *settled_from.get_or_insert(sample.time_s + SETTLING_LEFT_OUT_S);
            let Some(estimate) = estimate.filter(|_| sample.touches()) else {
                continue;
            };
            alignments.push(angle_deg(&estimate.normal, &-sample.tool_z));
            let Some(truth) = &sample.truth else { continue };
            let error = angle_deg(&estimate.normal, &truth.normal);
            errors.push(error);
            if sample.time_s >= from {
                settled.push(error);
            }
            if estimate.valid {
                let found = nees_of_normal(&estimate.normal, &estimate.covariance, &truth.normal);
                nees.extend(found);
            }
        }
        Self {
            normal_error_deg: Spread::of(&mut errors),
            normal_error_settled_deg: Spread::of(&mut settled),
            alignment_error_deg: Spread::of(&mut alignments),
            normal_nees_per_dof: mean(&nees),
        }
    }
}

/// Angle between two unit vectors, degrees; accurate for small angles, unlike an arc cosine.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_simulation::metrics::angle_deg;
///
/// assert!((angle_deg(&Vector3::x(), &Vector3::y()) - 90.0).abs() < 1e-12);
/// ```
pub fn angle_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

/// Normalised squared error of a normal in its tangent plane, per degree of freedom (two); `None`
/// if the covariance (rad²) is singular there.
///
/// ```
/// use nalgebra::{Matrix3, Vector3};
/// use tangent_simulation::metrics::nees_of_normal;
///
/// // 0.02 rad off, with a stated standard deviation of 0.01 rad: 2² over two degrees of freedom.
/// let truth = Vector3::new(0.02_f64.sin(), 0.0, 0.02_f64.cos());
/// let nees = nees_of_normal(&Vector3::z(), &(Matrix3::identity() * 1e-4), &truth).unwrap();
/// assert!((nees - 2.0).abs() < 0.001);
/// ```
pub fn nees_of_normal(
    n: &Vector3<f64>,
    covariance: &Matrix3<f64>,
    truth: &Vector3<f64>,
) -> Option<f64> {
    let seed = if n.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let a = n.cross(&seed).normalize();
    let b = n.cross(&a);
    let p = covariance;
    let (aa, ab, bb) = (a.dot(&(p * a)), a.dot(&(p * b)), b.dot(&(p * b)));
    let determinant = aa * bb - ab * ab;
    let (ea, eb) = (truth.dot(&a), truth.dot(&b));
    let value = (bb * ea * ea - 2.0 * ab * ea * eb + aa * eb * eb) / determinant / 2.0;
    (determinant > 0.0 && value.is_finite()).then_some(value)
}
