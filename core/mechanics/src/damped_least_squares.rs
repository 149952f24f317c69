//! Joint velocities for a desired twist, damped near singularities.
//!
//! The controller converts the twist of its law into joint velocities with it once per robot cycle.

use nalgebra::{SMatrix, SVector, Vector6};
use serde::{Deserialize, Serialize};

use crate::Joints;

/// Minimises |J qd - v|² + λ²|qd|² with a damping that grows towards a singularity.
///
/// qd = Σ σᵢ/(σᵢ² + λ²) vᵢ uᵢᵀ v over the singular values of J, with λ² = (1 - (σ_min/ε)²) λ_max²
/// where σ_min < ε, else 0. Damped least squares for arms: Nakamura, Hanafusa 1986. This damping is
/// continuous, and exactly zero away from singularities: Chiaverini 1997, eq. (17). For every
/// Jacobian |qd| ≤ [`DampedLeastSquares::gain_max`] |v|.
///
/// σ mixes metres and radians, as J does.
///
/// ```
/// use nalgebra::Vector6;
/// use tangent_mechanics::{Arm, DampedLeastSquares, Joints, ModelData};
///
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// let solver = DampedLeastSquares::default();
/// let twist = Vector6::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0);
/// // Bounded even in a singularity.
/// let solution = solver.solve_with_damping(&arm.jacobian(&Joints::zeros()), &twist);
/// assert!(solution.damping > 0.0);
/// assert!(solution.qd.norm() <= solver.gain_max() * twist.norm());
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DampedLeastSquares {
    /// λ_max, the damping in a singularity.
    pub damping_max: f64,
    /// ε, the smallest singular value below which damping starts.
    pub threshold: f64,
}

impl Default for DampedLeastSquares {
    /// λ_max 0.04 and ε 0.06: at most 17 rad/s per m/s. A UR5 at home has σ_min = 0.22.
    fn default() -> Self {
        Self {
            damping_max: 0.04,
            threshold: 0.06,
        }
    }
}

/// Joint velocities and damping, from [`DampedLeastSquares::solve_with_damping`].
///
/// ```
/// use nalgebra::{SMatrix, Vector6};
/// use tangent_mechanics::DampedLeastSquares;
/// // A well-conditioned Jacobian is inverted exactly.
/// let jacobian = SMatrix::<f64, 6, 6>::identity() * 0.5;
/// let solution =
///     DampedLeastSquares::default().solve_with_damping(&jacobian, &Vector6::repeat(0.1));
/// assert_eq!(solution.damping, 0.0);
/// assert!((solution.qd - Vector6::repeat(0.2)).norm() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DampedSolution<const N: usize> {
    /// Joint velocities, rad/s.
    pub qd: Joints<N>,
    /// σ_min of the Jacobian.
    pub smallest_singular_value: f64,
    /// λ in use; 0 away from singularities, where the twist is reproduced exactly.
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

    /// Joint velocities (rad/s) for a twist (m/s, rad/s) at the Jacobian's point and in its axes,
    /// with the smallest singular value and the damping used.
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
            // Skips directions in which the arm cannot move: the zero singular values of a J with
            // fewer than six columns.
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

    /// λ for a given smallest singular value.
    pub fn damping(&self, smallest_singular_value: f64) -> f64 {
        if smallest_singular_value >= self.threshold {
            return 0.0;
        }
        let share = smallest_singular_value / self.threshold;
        self.damping_max * (1.0 - share * share).max(0.0).sqrt()
    }

    /// Largest |qd|/|v| for any Jacobian: the peak of σ/(σ² + λ²(σ)), at least 1/ε.
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

/// Singular values and vectors of a 6 × N Jacobian, by one-sided Jacobi rotations (Hestenes 1958)
/// on its transpose.
///
/// It does not allocate, its work is bounded, and small singular values are accurate.
pub(crate) struct Singular<const N: usize> {
    /// Left singular vectors uᵢ, in no order.
    left: [Vector6<f64>; 6],
    /// σᵢ vᵢ.
    scaled_right: [SVector<f64, N>; 6],
    /// Square of the σ below which a direction is rounding error.
    square_floor: f64,
    /// The smallest of the min(6, N) singular values.
    pub(crate) smallest: f64,
}

impl<const N: usize> Singular<N> {
    /// Five or six sweeps are usual. The bound limits the time for a Jacobian that contains NaN.
    const SWEEPS_MAX: usize = 20;

    pub(crate) fn of(jacobian: &SMatrix<f64, 6, N>) -> Self {
        let mut right: [SVector<f64, N>; 6] = std::array::from_fn(|i| jacobian.row(i).transpose());
        let mut left: [Vector6<f64>; 6] =
            std::array::from_fn(|i| Vector6::from_fn(|j, _| f64::from(i == j)));
        // Columns this short relative to the matrix are rounding error: rotating them would never
        // converge.
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

/// Makes columns `i` and `j` orthogonal; false if they already were.
fn rotate<const N: usize>(
    right: &mut [SVector<f64, N>; 6],
    left: &mut [Vector6<f64>; 6],
    i: usize,
    j: usize,
    square_floor: f64,
) -> bool {
    let (a, b) = (right[i].norm_squared(), right[j].norm_squared());
    let product = right[i].dot(&right[j]);
    // A few ulp of the lengths.
    let orthogonal = product.abs() <= 4.0 * f64::EPSILON * (a * b).sqrt();
    if orthogonal || product.is_nan() || a.min(b) <= square_floor {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Arm, ModelData, manipulability, smallest_singular_value};
    use proptest::prelude::*;

    fn arm<const N: usize>(name: &str) -> Arm<N> {
        Arm::new(&ModelData::builtin(name).unwrap()).unwrap()
    }

    fn bounded<const N: usize>(
        name: &str,
        q: &[f64],
        twist: [f64; 6],
        law: &DampedLeastSquares,
    ) -> Result<(), TestCaseError> {
        let jacobian = arm::<N>(name).jacobian(&Joints::from_column_slice(&q[..N]));
        let twist = Vector6::from(twist);
        let solution = law.solve_with_damping(&jacobian, &twist);
        let bound = law.gain_max() * twist.norm() * (1.0 + 1e-9);
        prop_assert!(
            solution.qd.norm() <= bound,
            "{name}: {} > {bound}",
            solution.qd.norm()
        );
        if solution.damping == 0.0 && N >= 6 {
            let missed = (jacobian * solution.qd - twist).norm();
            prop_assert!(
                missed < 1e-9 * (1.0 + twist.norm()),
                "{name}: misses by {missed}"
            );
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn no_pose_and_no_twist_breaks_the_bound(
            q in prop::collection::vec(-3.2f64..3.2, 7),
            closeness in 1e-12f64..1.0,
            twist in prop::array::uniform6(-1.0f64..1.0),
            damping_max in 0.01f64..0.2,
            threshold in 0.02f64..0.2,
        ) {
            let law = DampedLeastSquares { damping_max, threshold };
            bounded::<6>("ur5", &q, twist, &law)?;
            bounded::<7>("panda", &q, twist, &law)?;
            bounded::<6>("smart3s_substitute", &q, twist, &law)?;
            bounded::<2>("planar2", &q, twist, &law)?;
            // Towards the singularity: elbow straight, then wrist axes parallel.
            let mut near = q;
            near[2] = closeness.powi(3);
            bounded::<6>("ur5", &near, twist, &law)?;
            near[4] = closeness.powi(5);
            bounded::<6>("ur5", &near, twist, &law)?;
        }

        #[test]
        fn singular_values_rebuild_the_jacobian(q in prop::collection::vec(-3.2f64..3.2, 7)) {
            let jacobian = arm::<7>("panda").jacobian(&Joints::from_column_slice(&q));
            let singular = Singular::of(&jacobian);
            let mut rebuilt = SMatrix::<f64, 6, 7>::zeros();
            let mut product = 1.0;
            for i in 0..6 {
                rebuilt += singular.left[i] * singular.scaled_right[i].transpose();
                product *= singular.scaled_right[i].norm();
            }
            prop_assert!((rebuilt - jacobian).amax() < 1e-13);
            let volume = manipulability(&jacobian);
            prop_assert!((product - volume).abs() < 1e-13, "{product} {volume}");
            let squared = (jacobian * jacobian.transpose()).determinant();
            prop_assert!((squared - volume * volume).abs() < 1e-10);
        }
    }

    #[test]
    fn every_near_singular_pose_of_every_model_is_bounded_and_seen() {
        let law = DampedLeastSquares::default();
        let mut seen = 0;
        for name in ModelData::builtin_names() {
            let model = ModelData::builtin(name).unwrap();
            if model.dof != 6 {
                continue;
            }
            seen += model.near_singular.len();
            let arm = arm::<6>(name);
            for pose in &model.near_singular {
                let jacobian = arm.jacobian(&Joints::from_column_slice(&pose.q_rad));
                for axis in 0..6 {
                    let twist = Vector6::ith(axis, 1.0);
                    let solution = law.solve_with_damping(&jacobian, &twist);
                    assert!(
                        solution.smallest_singular_value < 1e-4,
                        "{name} {}",
                        pose.id
                    );
                    assert!(solution.damping > 0.999 * law.damping_max);
                    assert!(solution.qd.norm() <= law.gain_max());
                }
            }
        }
        assert!(seen > 0);
    }

    #[test]
    fn exactly_singular_costs_no_speed_in_the_lost_direction() {
        // UR5 with its elbow straight: one direction of the tool is lost, and no joint moves for
        // it.
        let jacobian = arm::<6>("ur5").jacobian(&Joints::from([0.3, -0.9, 0.0, 0.5, 1.1, -0.4]));
        let singular = Singular::of(&jacobian);
        let lost = (0..6)
            .min_by(|&a, &b| {
                let length = |i: usize| singular.scaled_right[i].norm();
                length(a).total_cmp(&length(b))
            })
            .unwrap();
        let qd = DampedLeastSquares::default().solve(&jacobian, &singular.left[lost]);
        assert!(qd.norm() < 1e-10, "{qd}");
    }

    #[test]
    fn smallest_singular_values_of_the_golden_file() {
        let file: serde_json::Value =
            serde_json::from_str(include_str!("../tests/golden/golden.json")).unwrap();
        let cases = file["models"]["ur5"].as_array().unwrap();
        for case in cases {
            let q: Vec<f64> = serde_json::from_value(case["q"].clone()).unwrap();
            let jacobian = arm::<6>("ur5").jacobian(&Joints::from_column_slice(&q));
            let expected = case["jacobian_smallest_singular_value"].as_f64().unwrap();
            let found = smallest_singular_value(&jacobian);
            assert!(
                (found - expected).abs() < 1e-14,
                "{}: {found} {expected}",
                case["id"]
            );
        }
    }

    #[test]
    fn planar2_manipulability_by_hand() {
        // J'J = [[a + 1, b + 1], [b + 1, 0.25 + 1]] with a = 1.25 + cos q2, b = 0.25 + 0.5 cos q2.
        let q2 = 0.8_f64;
        let jacobian = arm::<2>("planar2").jacobian(&Joints::<2>::new(0.2, q2));
        let (a, b) = (1.25 + q2.cos(), 0.25 + 0.5 * q2.cos());
        let by_hand = ((a + 1.0) * 1.25 - (b + 1.0) * (b + 1.0)).sqrt();
        assert!((manipulability(&jacobian) - by_hand).abs() < 1e-15);
    }

    #[test]
    fn damping_is_continuous_and_grows_towards_the_singularity() {
        let law = DampedLeastSquares {
            damping_max: 0.1,
            threshold: 0.05,
        };
        assert_eq!(law.damping(0.0), 0.1);
        assert_eq!(law.damping(0.05), 0.0);
        assert_eq!(law.damping(1.0), 0.0);
        assert!((law.damping(0.025) - 0.1 * 0.75_f64.sqrt()).abs() < 1e-16);
        assert!(law.damping(0.049_999_9) < 1e-3);
    }

    #[test]
    fn not_a_number_ends() {
        let qd = DampedLeastSquares::default()
            .solve(&SMatrix::<f64, 6, 6>::repeat(f64::NAN), &Vector6::zeros());
        assert!(qd.iter().all(|x| x.is_nan() || *x == 0.0));
    }
}
