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

    /// The same for the origin of a tool fixed to the flange: `Aligned<Tool, Base>`.
    pub fn jacobian_at(
        &self,
        q: &Joints<N>,
        flange_from_tool: &Pose<Flange, Tool>,
    ) -> SMatrix<f64, 6, N> {
        let frames = self.frames(q);
        jacobian_of(&frames, &tool_origin(&frames, flange_from_tool))
    }

    /// Pose of a tool and its Jacobian (as [`Arm::jacobian_at`]) for the price of one pass.
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

    /// The flange's acceleration that comes from `qd` alone: acceleration = `jacobian` qdd + this
    /// (m/s², then rad/s², flange origin, base axes).
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

/// The same columns differentiated: axes turn with the links before them, origins move with them.
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
