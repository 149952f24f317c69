//! Solution of a small linear system with a symmetric positive definite matrix, without allocation.
//!
//! Used by forward dynamics, inverse kinematics, the momentum observer and the simulated
//! torque-controlled arm.

use nalgebra::{SMatrix, SVector};

/// Solves `matrix` x = `right` by L D Lᵀ decomposition, which needs no square roots. Only the lower
/// triangle is read.
///
/// `None` if the matrix is not positive definite in floating point.
///
/// ```
/// use nalgebra::{Matrix2, Vector2};
/// use tangent_mechanics::linear_solve::solve_positive_definite;
/// let matrix = Matrix2::new(2.0, 0.0, 1.0, 3.0);
/// let x = solve_positive_definite(&matrix, &Vector2::new(4.0, 7.0));
/// assert_eq!(x, Some(Vector2::new(1.0, 2.0)));
/// assert_eq!(solve_positive_definite(&-matrix, &Vector2::zeros()), None);
/// ```
pub fn solve_positive_definite<const N: usize>(
    matrix: &SMatrix<f64, N, N>,
    right: &SVector<f64, N>,
) -> Option<SVector<f64, N>> {
    let mut lower = *matrix;
    for j in 0..N {
        let mut pivot = lower[(j, j)];
        for k in 0..j {
            pivot -= lower[(j, k)] * lower[(j, k)] * lower[(k, k)];
        }
        // Written so that NaN is refused too.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        lower[(j, j)] = pivot;
        for i in j + 1..N {
            let mut entry = lower[(i, j)];
            for k in 0..j {
                entry -= lower[(i, k)] * lower[(j, k)] * lower[(k, k)];
            }
            lower[(i, j)] = entry / pivot;
        }
    }
    let mut x = *right;
    for i in 0..N {
        for k in 0..i {
            x[i] -= lower[(i, k)] * x[k];
        }
    }
    for i in (0..N).rev() {
        x[i] /= lower[(i, i)];
        for k in i + 1..N {
            x[i] -= lower[(k, i)] * x[k];
        }
    }
    Some(x)
}
