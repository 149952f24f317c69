//! Joint velocities for a wanted twist, damped near singularities.
//!
//! The controller turns its twist into joint velocities with this, once per robot cycle.

use nalgebra::{SMatrix, SVector, Vector6};
use serde::{Deserialize, Serialize};

use crate::Joints;

/// Minimises |J qd - v|² + λ²|qd|² with a damping that grows towards a singularity.
///
/// qd = Σ σᵢ/(σᵢ² + λ²) vᵢ uᵢᵀ v over the singular values of J, with
/// λ² = (1 - (σ_min/ε)²) λ_max² where σ_min < ε, else 0. Damped least squares for arms: Nakamura, Hanafusa 1986;
/// this damping, continuous and exactly zero away from singularities: Chiaverini 1997, eq. (17). For every Jacobian
/// |qd| ≤ [`DampedLeastSquares::gain_max`] |v|.
///
/// σ mixes metres and radians, as J does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DampedLeastSquares {
    /// λ_max, the damping in the singularity itself.
    pub damping_max: f64,
    /// ε, the smallest singular value below which damping starts.
    pub threshold: f64,
}

impl Default for DampedLeastSquares {
    /// λ_max 0.04 and ε 0.06: at most 17 rad/s per m/s. A UR5 in a working pose has σ_min of 0.1 to 0.25.
    fn default() -> Self {
        Self {
            damping_max: 0.04,
            threshold: 0.06,
        }
    }
}

/// What [`DampedLeastSquares::solve_with_damping`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DampedSolution<const N: usize> {
    /// Joint velocities, rad/s.
    pub qd: Joints<N>,
    /// σ_min of the Jacobian.
    pub smallest_singular_value: f64,
    /// λ used; 0 away from singularities, where the twist is met exactly.
    pub damping: f64,
}

impl DampedLeastSquares {
    /// Joint velocities (rad/s) for a twist (m/s, rad/s) at the Jacobian's point and in its axes.
    pub fn solve<const N: usize>(
        &self,
        jacobian: &SMatrix<f64, 6, N>,
        twist: &Vector6<f64>,
    ) -> Joints<N> {
        self.solve_with_damping(jacobian, twist).qd
    }

    /// The same, with how close the singularity was.
    pub fn solve_with_damping<const N: usize>(
        &self,
        jacobian: &SMatrix<f64, 6, N>,
        twist: &Vector6<f64>,
    ) -> DampedSolution<N> {
        let singular = Singular::of(jacobian);
        let damping = self.damping(singular.smallest);
        let mut qd = Joints::zeros();
        for i in 0..6 {
            let square = singular.scaled_right[i].norm_squared();
            // Directions that the arm does not have at all: the zeros of a J with fewer than six columns.
            if square > singular.square_floor {
                let along = singular.left[i].dot(twist);
                qd += singular.scaled_right[i] * (along / (square + damping * damping));
            }
        }
        DampedSolution {
            qd,
            smallest_singular_value: singular.smallest,
            damping,
        }
    }

    /// λ for a smallest singular value.
    pub fn damping(&self, smallest_singular_value: f64) -> f64 {
        if smallest_singular_value >= self.threshold {
            return 0.0;
        }
        let share = smallest_singular_value / self.threshold;
        self.damping_max * (1.0 - share * share).max(0.0).sqrt()
    }

    /// The largest |qd|/|v| that any Jacobian can lead to: the peak of σ/(σ² + λ²(σ)), and no less than 1/ε.
    pub fn gain_max(&self) -> f64 {
        let ratio = self.damping_max / self.threshold;
        let at_threshold = 1.0 / self.threshold;
        // Below a ratio of √½ the peak lies inside the damped region, above it at its edge.
        if ratio * ratio < 0.5 {
            at_threshold.max(0.5 / (self.damping_max * (1.0 - ratio * ratio).sqrt()))
        } else {
            at_threshold
        }
    }
}

/// Singular values and vectors of a 6 × N Jacobian, by one-sided Jacobi rotations (Hestenes 1958) on its transpose.
///
/// Fixed work without allocation, and small singular values keep their digits.
pub(crate) struct Singular<const N: usize> {
    /// Left singular vectors uᵢ, in no order.
    left: [Vector6<f64>; 6],
    /// σᵢ vᵢ.
    scaled_right: [SVector<f64, N>; 6],
    /// σ below which a direction is rounding, squared.
    square_floor: f64,
    /// The smallest of the min(6, N) singular values.
    pub(crate) smallest: f64,
}

impl<const N: usize> Singular<N> {
    /// Five or six sweeps are usual; the bound keeps the time bounded for a Jacobian that is not a number.
    const SWEEPS_MAX: usize = 20;

    pub(crate) fn of(jacobian: &SMatrix<f64, 6, N>) -> Self {
        let mut right: [SVector<f64, N>; 6] = std::array::from_fn(|i| jacobian.row(i).transpose());
        let mut left: [Vector6<f64>; 6] =
            std::array::from_fn(|i| Vector6::from_fn(|j, _| f64::from(i == j)));
        // Columns this short against the matrix are rounding: rotating them further would never end.
        let square_floor = jacobian.norm_squared() * (f64::EPSILON * f64::EPSILON);
        for _ in 0..Self::SWEEPS_MAX {
            let mut turned = false;
            for i in 0..5 {
                for j in i + 1..6 {
                    turned |= rotate(&mut right, &mut left, i, j, square_floor);
                }
            }
            if !turned {
                break;
            }
        }
        let mut values: [f64; 6] = std::array::from_fn(|i| right[i].norm());
        values.sort_by(|a, b| b.total_cmp(a));
        Self {
            left,
            scaled_right: right,
            square_floor,
            smallest: values[N.clamp(1, 6) - 1],
        }
    }
}

/// Makes columns `i` and `j` orthogonal; false if they were.
fn rotate<const N: usize>(
    right: &mut [SVector<f64, N>; 6],
    left: &mut [Vector6<f64>; 6],
    i: usize,
    j: usize,
    square_floor: f64,
) -> bool {
    let (a, b) = (right[i].norm_squared(), right[j].norm_squared());
    let product = right[i].dot(&right[j]);
    // A few ulp of the lengths; NaN leaves here as well.
    if !(product.abs() > 4.0 * f64::EPSILON * (a * b).sqrt()) || a.min(b) <= square_floor {
        return false;
    }
    let zeta = (b - a) / (2.0 * product);
    let tangent = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
    let sine = cosine * tangent;
    (right[i], right[j]) = (
        right[i] * cosine - right[j] * sine,
        right[i] * sine + right[j] * cosine,
    );
    (left[i], left[j]) = (
        left[i] * cosine - left[j] * sine,
        left[i] * sine + left[j] * cosine,
    );
    true
}
