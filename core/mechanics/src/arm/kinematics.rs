//! Forward kinematics, the geometric Jacobian and its derivative.

use nalgebra::{Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3, Vector6};

use super::{Arm, Step};
use crate::{Base, Flange, Joints, Pose, Tool};

/// Frames of all joints (turned by their angles) and of the flange, in base axes.
pub(super) struct Frames<const N: usize> {
    pub(super) joints: [Step; N],
    pub(super) flange: Step,
}

impl<const N: usize> Frames<N> {
    pub(super) fn axis(&self, i: usize) -> Vector3<f64> {
        self.joints[i].rotation.column(2).into_owned()
    }

    pub(super) fn origin(&self, i: usize) -> Vector3<f64> {
        self.joints[i].origin
    }
}

impl<const N: usize> Arm<N> {
    /// Pose of the flange, m; `q` in rad.
    pub fn base_from_flange(&self, q: &Joints<N>) -> Pose<Base, Flange> {
        let flange = self.frames(q).flange;
        let rotation = Rotation3::from_matrix_unchecked(flange.rotation);
        Pose::new(
            flange.origin,
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    /// Geometric Jacobian, 6 × N: `jacobian * qd` is the twist of the flange's origin in base axes,
    /// `Aligned<Flange, Base>` (rows 0-2 m/s, rows 3-5 rad/s).
    pub fn jacobian(&self, q: &Joints<N>) -> SMatrix<f64, 6, N> {
        let frames = self.frames(q);
        jacobian_of(&frames, &frames.flange.origin)
    }

    /// Geometric Jacobian, 6 × N, at the origin of a tool fixed to the flange: `jacobian * qd` is
    /// the twist of that origin in base axes, `Aligned<Tool, Base>` (rows 0-2 m/s, rows 3-5 rad/s).
    pub fn jacobian_at(
        &self,
        q: &Joints<N>,
        flange_from_tool: &Pose<Flange, Tool>,
    ) -> SMatrix<f64, 6, N> {
        let frames = self.frames(q);
        jacobian_of(&frames, &tool_origin(&frames, flange_from_tool))
    }

    /// Pose of a tool and its Jacobian (as [`Arm::jacobian_at`]), from one pass over the joints.
    pub fn tool_and_jacobian(
        &self,
        q: &Joints<N>,
        flange_from_tool: &Pose<Flange, Tool>,
    ) -> (Pose<Base, Tool>, SMatrix<f64, 6, N>) {
        let frames = self.frames(q);
        let rotation = Rotation3::from_matrix_unchecked(frames.flange.rotation);
        let base_from_flange: Pose<Base, Flange> = Pose::new(
            frames.flange.origin,
            UnitQuaternion::from_rotation_matrix(&rotation),
        );
        let jacobian = jacobian_of(&frames, &tool_origin(&frames, flange_from_tool));
        (base_from_flange * *flange_from_tool, jacobian)
    }

    /// Time derivative of [`Arm::jacobian`] while the joints move with `qd` (rad/s).
    pub fn jacobian_dot(&self, q: &Joints<N>, qd: &Joints<N>) -> SMatrix<f64, 6, N> {
        let frames = self.frames(q);
        jacobian_dot_of(&frames, qd, &frames.flange.origin)
    }

    /// Time derivative of [`Arm::jacobian_at`] while the joints move with `qd` (rad/s).
    pub fn jacobian_dot_at(
        &self,
        q: &Joints<N>,
        qd: &Joints<N>,
        flange_from_tool: &Pose<Flange, Tool>,
    ) -> SMatrix<f64, 6, N> {
        let frames = self.frames(q);
        jacobian_dot_of(&frames, qd, &tool_origin(&frames, flange_from_tool))
    }

    /// Acceleration of the flange due to the joint velocities alone: acceleration =
    /// `jacobian * qdd` plus this (m/s², then rad/s², flange origin, base axes).
    pub fn jacobian_dot_qd(&self, q: &Joints<N>, qd: &Joints<N>) -> Vector6<f64> {
        self.jacobian_dot(q, qd) * qd
    }

    pub(super) fn frames(&self, q: &Joints<N>) -> Frames<N> {
        let mut joints = [Step::IDENTITY; N];
        let mut reached = Step::IDENTITY;
        for i in 0..N {
            let mut step = reached.then(&self.steps[i]);
            step.rotation = turned_about_z(&step.rotation, q[i] + self.offsets[i]);
            joints[i] = step;
            reached = step;
        }
        Frames {
            joints,
            flange: reached.then(&self.flange),
        }
    }
}

/// `rotation * RotZ(angle)` without the multiplications by zero.
fn turned_about_z(rotation: &Matrix3<f64>, angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    let (x, y) = (rotation.column(0), rotation.column(1));
    Matrix3::from_columns(&[
        x * c + y * s,
        y * c - x * s,
        rotation.column(2).into_owned(),
    ])
}

fn tool_origin<const N: usize>(
    frames: &Frames<N>,
    flange_from_tool: &Pose<Flange, Tool>,
) -> Vector3<f64> {
    frames.flange.origin + frames.flange.rotation * flange_from_tool.translation()
}

/// Column i is (z_i × (p - p_i), z_i): Siciliano et al., Robotics, eq. (3.30).
fn jacobian_of<const N: usize>(frames: &Frames<N>, point: &Vector3<f64>) -> SMatrix<f64, 6, N> {
    let mut jacobian: SMatrix<f64, 6, N> = SMatrix::zeros();
    for i in 0..N {
        let axis = frames.axis(i);
        let linear = axis.cross(&(point - frames.origin(i)));
        jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&linear);
        jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&axis);
    }
    jacobian
}

/// Time derivative of the columns of `jacobian_of`: axes turn with the links before them, origins
/// move with them.
fn jacobian_dot_of<const N: usize>(
    frames: &Frames<N>,
    qd: &Joints<N>,
    point: &Vector3<f64>,
) -> SMatrix<f64, 6, N> {
    // Velocity of each joint's origin and of the point, and the angular velocity before each joint.
    let mut origin_velocity = [Vector3::zeros(); N];
    let mut angular_before = [Vector3::zeros(); N];
    let (mut angular, mut velocity) = (Vector3::zeros(), Vector3::zeros());
    for i in 0..N {
        if i > 0 {
            velocity += angular.cross(&(frames.origin(i) - frames.origin(i - 1)));
        }
        origin_velocity[i] = velocity;
        angular_before[i] = angular;
        angular += frames.axis(i) * qd[i];
    }
    let last = frames.joints.last().map_or(*point, |joint| joint.origin);
    let point_velocity = velocity + angular.cross(&(point - last));
    let mut derivative: SMatrix<f64, 6, N> = SMatrix::zeros();
    for i in 0..N {
        let axis = frames.axis(i);
        let axis_dot = angular_before[i].cross(&axis);
        let linear = axis_dot.cross(&(point - frames.origin(i)))
            + axis.cross(&(point_velocity - origin_velocity[i]));
        derivative.fixed_view_mut::<3, 1>(0, i).copy_from(&linear);
        derivative.fixed_view_mut::<3, 1>(3, i).copy_from(&axis_dot);
    }
    derivative
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ModelData;
    use proptest::prelude::*;

    fn joints<const N: usize>(values: &[f64]) -> Joints<N> {
        Joints::from_column_slice(&values[..N])
    }

    fn tool() -> Pose<Flange, Tool> {
        Pose::new(
            Vector3::new(0.03, -0.08, 0.17),
            UnitQuaternion::new(Vector3::new(0.4, -0.3, 0.9)),
        )
    }

    /// Central difference of the tool's pose along `qd`, which defines the columns of the Jacobian.
    fn twist_by_difference<const N: usize>(
        arm: &Arm<N>,
        q: &Joints<N>,
        qd: &Joints<N>,
    ) -> Vector6<f64> {
        let h = 1e-6;
        let after = arm.base_from_flange(&(q + qd * h)) * tool();
        let before = arm.base_from_flange(&(q - qd * h)) * tool();
        let linear = (after.translation() - before.translation()) / (2.0 * h);
        let angular = (after.rotation() * before.rotation().inverse()).scaled_axis() / (2.0 * h);
        Vector6::new(
            linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
        )
    }

    fn jacobians_are_derivatives<const N: usize>(
        name: &str,
        q: &[f64],
        qd: &[f64],
    ) -> Result<(), TestCaseError> {
        let arm = Arm::<N>::new(&ModelData::builtin(name).unwrap()).unwrap();
        let (q, qd) = (joints::<N>(q), joints::<N>(qd));
        let (pose, jacobian) = arm.tool_and_jacobian(&q, &tool());
        prop_assert_eq!(jacobian, arm.jacobian_at(&q, &tool()));
        prop_assert_eq!(pose, arm.base_from_flange(&q) * tool());
        let difference = (jacobian * qd - twist_by_difference(&arm, &q, &qd)).amax();
        prop_assert!(difference < 1e-8, "{name}: J off by {difference}");

        let h = 1e-6;
        let by_difference = (arm.jacobian_at(&(q + qd * h), &tool())
            - arm.jacobian_at(&(q - qd * h), &tool()))
            / (2.0 * h);
        let difference = (arm.jacobian_dot_at(&q, &qd, &tool()) - by_difference).amax();
        prop_assert!(difference < 1e-8, "{name}: Jdot off by {difference}");

        // A tool of zero length is the flange.
        let flange = Pose::identity();
        prop_assert_eq!(arm.jacobian(&q), arm.jacobian_at(&q, &flange));
        prop_assert_eq!(
            arm.jacobian_dot(&q, &qd),
            arm.jacobian_dot_at(&q, &qd, &flange)
        );
        Ok(())
    }

    proptest! {
        #[test]
        fn jacobian_and_its_derivative_match_finite_differences(
            q in prop::collection::vec(-3.0f64..3.0, 7),
            qd in prop::collection::vec(-1.0f64..1.0, 7),
        ) {
            jacobians_are_derivatives::<6>("ur5", &q, &qd)?;
            jacobians_are_derivatives::<6>("ur5e", &q, &qd)?;
            jacobians_are_derivatives::<7>("panda", &q, &qd)?;
            jacobians_are_derivatives::<6>("smart3s_substitute", &q, &qd)?;
            jacobians_are_derivatives::<2>("planar2", &q, &qd)?;
        }
    }

    #[test]
    fn planar2_by_hand() {
        let arm = Arm::<2>::new(&ModelData::builtin("planar2").unwrap()).unwrap();
        let (q1, q2) = (0.3_f64, -1.1_f64);
        let (s1, c1) = q1.sin_cos();
        let (s12, c12) = (q1 + q2).sin_cos();
        let q = Joints::<2>::new(q1, q2);
        let tip = arm.base_from_flange(&q);
        let by_hand = Vector3::new(c1 + 0.5 * c12, s1 + 0.5 * s12, 0.0);
        assert!((tip.translation() - by_hand).norm() < 1e-15);
        assert!((tip.rotation().scaled_axis() - Vector3::new(0.0, 0.0, q1 + q2)).norm() < 1e-15);
        let jacobian = arm.jacobian(&q);
        let rows = [[-s1 - 0.5 * s12, -0.5 * s12], [c1 + 0.5 * c12, 0.5 * c12]];
        for (i, row) in rows.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                assert!((jacobian[(i, j)] - entry).abs() < 1e-15);
            }
        }
        assert_eq!(jacobian[(5, 0)], 1.0);
        assert_eq!(jacobian[(5, 1)], 1.0);
    }

    #[test]
    fn ur5_reaches_as_far_as_its_table_says() {
        // Stretched along x with the elbow straight: the sums of the table's rows.
        let arm = Arm::<6>::new(&ModelData::builtin("ur5").unwrap()).unwrap();
        let pose = arm.base_from_flange(&Joints::zeros());
        let by_hand = Vector3::new(-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465);
        assert!((pose.translation() - by_hand).norm() < 1e-15, "{pose:?}");
    }
}
