//! Measures of the distance of a Jacobian from singular.

use nalgebra::{SMatrix, SVector};

use crate::damped_least_squares::Singular;

/// Yoshikawa's manipulability √det(J Jᵀ) (Yoshikawa 1985); for fewer than six joints √det(Jᵀ J).
///
/// The value mixes metres and radians, as the Jacobian does. It compares poses of one arm, not
/// different arms.
///
/// ```
/// use tangent_mechanics::{Arm, Joints, ModelData, manipulability};
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// // With all joints at zero, the elbow is straight: a singularity.
/// assert!(manipulability(&arm.jacobian(&Joints::zeros())) < 1e-9);
/// assert!(manipulability(&arm.jacobian(&arm.home())) > 1e-3);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
pub fn manipulability<const N: usize>(jacobian: &SMatrix<f64, 6, N>) -> f64 {
    // Volume that the rows (or columns) span, by Gram-Schmidt. Unlike the determinant of J Jᵀ, it
    // is accurate near a singularity.
    if N >= 6 {
        volume(std::array::from_fn::<SVector<f64, N>, 6, _>(|i| {
            jacobian.row(i).transpose()
        }))
    } else {
        volume(std::array::from_fn::<SVector<f64, 6>, N, _>(|i| {
            jacobian.column(i).into_owned()
        }))
    }
}

/// Smallest singular value of a Jacobian, of min(6, N).
pub fn smallest_singular_value<const N: usize>(jacobian: &SMatrix<f64, 6, N>) -> f64 {
    Singular::of(jacobian).smallest
}

fn volume<const D: usize, const K: usize>(mut vectors: [SVector<f64, D>; K]) -> f64 {
    let mut product = 1.0;
    for i in 0..K {
        let length = vectors[i].norm();
        product *= length;
        if length > 0.0 {
            let unit = vectors[i] / length;
            for other in &mut vectors[i + 1..] {
                *other -= unit * unit.dot(other);
            }
        }
    }
    product
}
