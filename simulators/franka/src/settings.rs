//! Settings that a client has made at the robot, each checked against the robot's limits.

use nalgebra::{Matrix3, Matrix4, Vector3};
use tangent_franka::fci::{CollisionBehavior, Load, Request};
use tangent_mechanics::Payload;

/// Settings of the simulated robot.
#[derive(Clone, Debug)]
pub(crate) struct RobotSettings {
    pub behavior: CollisionBehavior,
    pub load: Load,
    /// Pose of the end effector relative to the nominal one, which is the flange.
    pub ne_t_ee: [f64; 16],
    /// Pose of the stiffness frame relative to the end effector.
    pub ee_t_k: [f64; 16],
}

impl Default for RobotSettings {
    fn default() -> Self {
        let identity = column_major(&Matrix4::identity());
        Self {
            behavior: CollisionBehavior {
                lower_torque_acceleration: [10.0; 7],
                upper_torque_acceleration: [20.0; 7],
                lower_torque_nominal: [10.0; 7],
                upper_torque_nominal: [20.0; 7],
                lower_force_acceleration: [10.0; 6],
                upper_force_acceleration: [20.0; 6],
                lower_force_nominal: [10.0; 6],
                upper_force_nominal: [20.0; 6],
            },
            load: Load {
                mass_kg: 0.0,
                com_in_flange_m: [0.0; 3],
                inertia_kg_m2: [0.0; 9],
            },
            ne_t_ee: identity,
            ee_t_k: identity,
        }
    }
}

impl RobotSettings {
    /// The settings of a robot whose tool was declared when it was installed.
    pub fn with_load(tool: &Payload) -> Self {
        let mut inertia_kg_m2 = [0.0; 9];
        inertia_kg_m2.copy_from_slice(tool.inertia_kg_m2.as_slice());
        Self {
            load: Load {
                mass_kg: tool.mass_kg,
                com_in_flange_m: tool.com_in_flange_m.into(),
                inertia_kg_m2,
            },
            ..Self::default()
        }
    }

    /// Applies one setting. Returns false, and changes nothing, for values that the robot refuses.
    pub fn set(&mut self, request: &Request) -> bool {
        match request {
            Request::SetCollisionBehavior(behavior) => {
                take(&mut self.behavior, behavior, are_thresholds(behavior))
            }
            Request::SetLoad(load) => take(&mut self.load, load, is_load(load)),
            Request::SetNeToEe(pose) => take(&mut self.ne_t_ee, pose, is_pose(pose)),
            Request::SetEeToK(pose) => take(&mut self.ee_t_k, pose, is_pose(pose)),
            Request::SetJointImpedance(k) => k.iter().all(|k| (0.0..=14_250.0).contains(k)),
            Request::SetCartesianImpedance(k) => {
                k[..3].iter().all(|k| (10.0..=3000.0).contains(k))
                    && k[3..].iter().all(|k| (1.0..=300.0).contains(k))
            }
            Request::SetFilters(f) => [
                f.joint_position_hz,
                f.joint_velocity_hz,
                f.cartesian_position_hz,
                f.cartesian_velocity_hz,
                f.controller_hz,
            ]
            .iter()
            .all(|f| (1.0..=1000.0).contains(f)),
            _ => true,
        }
    }

    /// The load as a body fixed to the flange.
    pub fn payload(&self) -> Payload {
        Payload {
            mass_kg: self.load.mass_kg,
            com_in_flange_m: Vector3::from(self.load.com_in_flange_m),
            inertia_kg_m2: Matrix3::from_column_slice(&self.load.inertia_kg_m2),
        }
    }
}

fn take<T: Copy>(into: &mut T, value: &T, good: bool) -> bool {
    if good {
        *into = *value;
    }
    good
}

fn are_thresholds(b: &CollisionBehavior) -> bool {
    let pairs: [(&[f64], &[f64]); 4] = [
        (&b.lower_torque_acceleration, &b.upper_torque_acceleration),
        (&b.lower_torque_nominal, &b.upper_torque_nominal),
        (&b.lower_force_acceleration, &b.upper_force_acceleration),
        (&b.lower_force_nominal, &b.upper_force_nominal),
    ];
    pairs.iter().all(|(lower, upper)| {
        lower
            .iter()
            .zip(*upper)
            .all(|(l, u)| *l > 0.0 && l <= u && u.is_finite())
    })
}

fn is_load(load: &Load) -> bool {
    (0.0..=20.0).contains(&load.mass_kg)
        && load.com_in_flange_m.iter().all(|x| x.abs() < 2.0)
        && load.inertia_kg_m2.iter().all(|x| x.is_finite())
}

/// Whether the matrix is a rotation and a translation, up to rounding.
fn is_pose(columns: &[f64; 16]) -> bool {
    let pose = matrix(columns);
    let rotation = pose.fixed_view::<3, 3>(0, 0).into_owned();
    let last = pose.row(3);
    columns.iter().all(|x| x.is_finite())
        && (rotation.transpose() * rotation - Matrix3::identity()).amax() < 1e-5
        && rotation.determinant() > 0.0
        && last.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| *a == b)
}

/// Matrix from the column-major order of the protocol.
pub(crate) fn matrix(columns: &[f64; 16]) -> Matrix4<f64> {
    Matrix4::from_column_slice(columns)
}

/// Matrix in the column-major order of the protocol.
pub(crate) fn column_major(matrix: &Matrix4<f64>) -> [f64; 16] {
    let mut columns = [0.0; 16];
    columns.copy_from_slice(matrix.as_slice());
    columns
}
