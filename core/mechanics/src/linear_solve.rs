//! Solving with a small symmetric positive definite matrix, without allocation: forward dynamics
//! here, the torque-controlled arm of the simulation above.

use nalgebra::{SMatrix, SVector};

/// `x` with `matrix` x = `right`, by L D Lᵀ without square roots; only the lower triangle is read.
///
/// `None` when the matrix is not positive definite in floating point.
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
