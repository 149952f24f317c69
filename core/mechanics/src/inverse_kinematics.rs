//! Joint angles for a pose of the tool, outside of the control loop.
//!
//! `tangent up`, the simulator and the tests compute start poses with it.

use nalgebra::{SMatrix, Vector3, Vector6};

use crate::linear_solve::solve_positive_definite;
use crate::{Arm, Base, Flange, Joints, Pose, Tool};

/// Why no joint angles were found.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Arm, InverseKinematicsError, ModelData, Pose, inverse_kinematics};
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// let too_far = Pose::new(Vector3::new(5.0, 0.0, 0.0), UnitQuaternion::identity());
/// let result = inverse_kinematics(&arm, &Pose::identity(), &too_far, &arm.home());
/// assert!(matches!(result, Err(InverseKinematicsError::Unreachable { .. })));
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InverseKinematicsError {
    /// The search reached the target from none of its starts within the joints' limits.
    #[error(
        "no joint angles within the limits bring the tool there: the nearest of {starts} tries stays {position_error_m:.4} m \
         and {angle_error_rad:.4} rad away; move the target closer to the base, turn it, or start from another pose"
    )]
    Unreachable {
        /// Number of starts.
        starts: usize,
        /// Remaining distance of the nearest result, m.
        position_error_m: f64,
        /// Remaining angle of the nearest result, rad.
        angle_error_rad: f64,
    },
    /// The target or the seed contains a NaN or an infinite number.
    #[error("the target pose or the seed is not finite")]
    NotFinite,
}

/// Settings of the search: Levenberg-Marquardt steps from a seed, then from starts at increasing
/// distance from it.
///
/// The damping is proportional to the squared error, so the steps stay bounded in singularities and
/// become Newton steps near the target: Sugihara 2011. The starts are a fixed low-discrepancy
/// sequence, so the result is reproducible bit by bit.
///
/// ```
/// use tangent_mechanics::{Arm, InverseKinematics, Joints, ModelData, Pose};
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// let q = arm.home() + Joints::repeat(0.1);
/// let target = arm.base_from_flange(&q) * Pose::identity();
/// let search = InverseKinematics { starts_max: 1, ..InverseKinematics::default() };
/// let found = search.solve(&arm, &Pose::identity(), &target, &arm.home());
/// assert!(found.is_ok_and(|found| (found - q).amax() < 1e-6));
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseKinematics {
    /// Largest remaining distance, m.
    pub position_tolerance_m: f64,
    /// Largest remaining angle, rad.
    pub angle_tolerance_rad: f64,
    /// Largest number of steps from each start.
    pub steps_max: usize,
    /// Largest number of starts, including the seed.
    pub starts_max: usize,
}

impl Default for InverseKinematics {
    fn default() -> Self {
        Self {
            position_tolerance_m: 1e-9,
            angle_tolerance_rad: 1e-9,
            steps_max: 100,
            starts_max: 256,
        }
    }
}

/// Joint angles (rad) that put the tool at `target`, by [`InverseKinematics::solve`] with the
/// default settings.
///
/// # Errors
/// The target is out of reach, or a number is not finite.
pub fn inverse_kinematics<const N: usize>(
    arm: &Arm<N>,
    flange_from_tool: &Pose<Flange, Tool>,
    target: &Pose<Base, Tool>,
    seed: &Joints<N>,
) -> Result<Joints<N>, InverseKinematicsError> {
    InverseKinematics::default().solve(arm, flange_from_tool, target, seed)
}

impl InverseKinematics {
    /// Joint angles (rad) within the arm's limits that put the tool at `target`, near `seed` if
    /// possible. A seed outside the limits is clamped to them first.
    ///
    /// # Errors
    /// The target is out of reach, or a number is not finite.
    pub fn solve<const N: usize>(
        &self,
        arm: &Arm<N>,
        flange_from_tool: &Pose<Flange, Tool>,
        target: &Pose<Base, Tool>,
        seed: &Joints<N>,
    ) -> Result<Joints<N>, InverseKinematicsError> {
        let finite = |x: &f64| x.is_finite();
        if !(seed.iter().all(finite) && target.matrix().iter().all(finite)) {
            return Err(InverseKinematicsError::NotFinite);
        }
        let mut nearest = Vector6::repeat(f64::INFINITY);
        for start in 0..self.starts_max {
            let from = arm.limits().clamp(&(seed + offset(start, self.starts_max)));
            let (q, error) = self.descend(arm, flange_from_tool, target, from);
            if self.reached(&error) {
                return Ok(unwound(arm, &q, seed));
            }
            if error.norm_squared() < nearest.norm_squared() {
                nearest = error;
            }
        }
        Err(InverseKinematicsError::Unreachable {
            starts: self.starts_max,
            position_error_m: linear(&nearest).norm(),
            angle_error_rad: angular(&nearest).norm(),
        })
    }

    fn reached(&self, error: &Vector6<f64>) -> bool {
        linear(error).norm() <= self.position_tolerance_m
            && angular(error).norm() <= self.angle_tolerance_rad
    }

    fn descend<const N: usize>(
        &self,
        arm: &Arm<N>,
        flange_from_tool: &Pose<Flange, Tool>,
        target: &Pose<Base, Tool>,
        mut q: Joints<N>,
    ) -> (Joints<N>, Vector6<f64>) {
        let (mut pose, mut jacobian) = arm.tool_and_jacobian(&q, flange_from_tool);
        let mut error = pose_error(target, &pose);
        let mut caution = 1.0;
        for _ in 0..self.steps_max {
            if self.reached(&error) {
                break;
            }
            let Some(step) = damped_step(arm, &jacobian, &error, &q, caution) else {
                break;
            };
            let tried = arm.limits().clamp(&(q + step));
            (pose, jacobian) = {
                let (tried_pose, tried_jacobian) = arm.tool_and_jacobian(&tried, flange_from_tool);
                let tried_error = pose_error(target, &tried_pose);
                if tried_error.norm_squared() < error.norm_squared() {
                    q = tried;
                    error = tried_error;
                    caution = (caution * 0.1).max(1e-6);
                    (tried_pose, tried_jacobian)
                } else {
                    caution *= 10.0;
                    if caution > 1e9 {
                        break;
                    }
                    (pose, jacobian)
                }
            };
        }
        (q, error)
    }
}

/// Solves (Jᵀ J + λ² I) step = Jᵀ error. A joint at a limit that the step would exceed is held.
fn damped_step<const N: usize>(
    arm: &Arm<N>,
    jacobian: &SMatrix<f64, 6, N>,
    error: &Vector6<f64>,
    q: &Joints<N>,
    caution: f64,
) -> Option<Joints<N>> {
    let limits = arm.limits();
    let mut jacobian = *jacobian;
    let gradient = jacobian.tr_mul(error);
    for i in 0..N {
        let held = (q[i] <= limits.position_lower[i] && gradient[i] < 0.0)
            || (q[i] >= limits.position_upper[i] && gradient[i] > 0.0);
        if held {
            jacobian.column_mut(i).fill(0.0);
        }
    }
    // The small constant keeps the matrix definite if the error vanishes in a singularity.
    let damping = caution * 1e-2 * error.norm_squared() + 1e-12;
    let mut normal = jacobian.tr_mul(&jacobian);
    for i in 0..N {
        normal[(i, i)] += damping;
    }
    solve_positive_definite(&normal, &jacobian.tr_mul(error))
}

/// Displacement (m), then rotation vector (rad) from `pose` to `target`, base axes.
fn pose_error(target: &Pose<Base, Tool>, pose: &Pose<Base, Tool>) -> Vector6<f64> {
    let linear = target.translation() - pose.translation();
    let angular = (target.rotation() * pose.rotation().inverse()).scaled_axis();
    Vector6::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}

fn linear(error: &Vector6<f64>) -> Vector3<f64> {
    error.fixed_rows::<3>(0).into_owned()
}

fn angular(error: &Vector6<f64>) -> Vector3<f64> {
    error.fixed_rows::<3>(3).into_owned()
}

/// Offset of a start from the seed: zero for the first, then points in a cube that grows to ±180°.
/// They follow Roberts' R-sequence, whose steps are the powers of the root of x^(N+1) = x + 1.
fn offset<const N: usize>(start: usize, starts: usize) -> Joints<N> {
    let mut root = 1.5_f64;
    for _ in 0..32 {
        root = (1.0 + root).powf(1.0 / (N as f64 + 1.0));
    }
    let reach = std::f64::consts::PI * start as f64 / starts as f64;
    let mut power = 1.0;
    Joints::from_fn(|_, _| {
        power /= root;
        reach * (2.0 * (0.5 + start as f64 * power).fract() - 1.0)
    })
}

/// Joint angles without the full turns that lead away from the seed, as far as the limits allow.
fn unwound<const N: usize>(arm: &Arm<N>, q: &Joints<N>, seed: &Joints<N>) -> Joints<N> {
    let limits = arm.limits();
    Joints::from_fn(|i, _| {
        let turns = ((seed[i] - q[i]) / std::f64::consts::TAU).round();
        let turned = q[i] + turns * std::f64::consts::TAU;
        if turned >= limits.position_lower[i] && turned <= limits.position_upper[i] {
            turned
        } else {
            q[i]
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ModelData;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    fn arm<const N: usize>(name: &str) -> Arm<N> {
        Arm::new(&ModelData::builtin(name).unwrap()).unwrap()
    }

    fn tool() -> Pose<Flange, Tool> {
        Pose::new(
            Vector3::new(0.01, 0.0, 0.15),
            UnitQuaternion::new(Vector3::new(0.0, 0.2, 0.0)),
        )
    }

    fn round_trip<const N: usize>(name: &str, shares: &[f64]) -> Result<(), TestCaseError> {
        let arm = arm::<N>(name);
        let limits = *arm.limits();
        let q = Joints::<N>::from_fn(|i, _| {
            // One turn is enough to reach every pose.
            let (low, high) = (
                limits.position_lower[i].max(-3.2),
                limits.position_upper[i].min(3.2),
            );
            low + (high - low) * shares[i]
        });
        let target = arm.base_from_flange(&q) * tool();
        let found = inverse_kinematics(&arm, &tool(), &target, &arm.home());
        prop_assert!(found.is_ok(), "{name} from home to {q}: {found:?}");
        let found = found.unwrap();
        prop_assert!(limits.contains(&found));
        let error = pose_error(&target, &(arm.base_from_flange(&found) * tool()));
        prop_assert!(error.amax() < 1e-8, "{name}: {error}");
        Ok(())
    }

    fn round_trip_everywhere(shares: &[f64]) -> Result<(), TestCaseError> {
        round_trip::<6>("ur5", shares)?;
        round_trip::<6>("ur5e", shares)?;
        round_trip::<7>("panda", shares)?;
        round_trip::<6>("smart3s_substitute", shares)
    }

    proptest! {
        #[test]
        fn every_pose_that_the_arm_can_take_is_found(
            shares in prop::collection::vec(0.02f64..0.98, 7),
        ) {
            round_trip_everywhere(&shares)?;
        }

        #[test]
        fn from_nearby_the_same_branch_is_found(
            moves in prop::array::uniform6(-0.1f64..0.1),
        ) {
            let arm = arm::<6>("ur5");
            let q = arm.home() + Joints::from(moves);
            let target = arm.base_from_flange(&q) * tool();
            let found = inverse_kinematics(&arm, &tool(), &target, &arm.home()).unwrap();
            prop_assert!((found - q).amax() < 1e-6, "{found} {q}");
        }
    }

    #[test]
    fn a_pose_at_three_limits_that_64_starts_missed() {
        round_trip_everywhere(&[
            0.945_84, 0.979_70, 0.044_18, 0.144_85, 0.864_34, 0.207_48, 0.02,
        ])
        .unwrap();
    }

    #[test]
    fn the_same_question_gets_the_same_bits() {
        let arm = arm::<6>("ur5");
        let q = Joints::from([1.0, -2.0, -1.0, 0.5, 2.0, -3.0]);
        let target = arm.base_from_flange(&q) * tool();
        let ask = || inverse_kinematics(&arm, &tool(), &target, &arm.home()).unwrap();
        assert_eq!(ask(), ask());
    }

    #[test]
    fn out_of_reach_says_how_far() {
        let arm = arm::<6>("ur5");
        let target = Pose::new(Vector3::new(2.0, 0.0, 0.3), UnitQuaternion::identity());
        let error = inverse_kinematics(&arm, &Pose::identity(), &target, &arm.home()).unwrap_err();
        let InverseKinematicsError::Unreachable {
            starts,
            position_error_m,
            ..
        } = error
        else {
            panic!("{error}");
        };
        assert_eq!(starts, 256);
        assert!(position_error_m > 0.9, "{error}");
        assert!(error.to_string().contains("move the target closer"));
    }

    #[test]
    fn not_a_number_is_refused() {
        let arm = arm::<6>("ur5");
        let seed = Joints::repeat(f64::NAN);
        let found = inverse_kinematics(&arm, &tool(), &Pose::identity(), &seed);
        assert_eq!(found, Err(InverseKinematicsError::NotFinite));
    }
}
