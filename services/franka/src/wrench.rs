//! The robot's own estimate of the external wrench, in the project's frames and signs.

use nalgebra::{Isometry3, Matrix4, Rotation3, Translation3, UnitQuaternion, Vector3};
use tangent_mechanics::{Flange, Frame, Pose, Tool, Wrench};

use crate::fci::RobotState;

/// The vendor's stiffness frame K, in which the estimate is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stiffness;

impl Frame for Stiffness {
    const NAME: &'static str = "stiffness";
}

/// Converts a pose from the robot's layout: 4 × 4, column by column, m.
pub fn pose_from_columns<A, B>(columns: &[f64; 16]) -> Pose<A, B> {
    let matrix = Matrix4::from_column_slice(columns);
    let rotation = Rotation3::from_matrix_unchecked(matrix.fixed_view::<3, 3>(0, 0).into_owned());
    Pose::from_isometry(Isometry3::from_parts(
        Translation3::new(matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

/// Wrench of the environment on the robot at the tool's origin, tool axes, N and Nm.
///
/// The robot reports its wrench on the environment, at and in K, which is fixed to the end effector
/// as set at the robot; the tool is fixed to the flange as the cell file states. The sign is
/// therefore reversed, and the wrench is moved from K to the tool.
pub fn tool_wrench(state: &RobotState, flange_from_tool: &Pose<Flange, Tool>) -> Wrench<Tool> {
    let flange_from_end: Pose<Flange, Stiffness> = pose_from_columns(&state.f_t_ee);
    let end_from_k: Pose<Stiffness, Stiffness> = pose_from_columns(&state.ee_t_k);
    let tool_from_k = flange_from_tool.inverse() * (flange_from_end * end_from_k);
    let [fx, fy, fz, mx, my, mz] = state.k_f_ext_hat_k;
    let on_robot = Wrench::new(-Vector3::new(fx, fy, fz), -Vector3::new(mx, my, mz));
    tool_from_k.transform_wrench(&on_robot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    fn columns<A, B>(pose: &Pose<A, B>) -> [f64; 16] {
        pose.matrix().as_slice().try_into().unwrap()
    }

    #[test]
    fn pressing_gives_a_force_out_of_the_surface() {
        // Tool 0.2 m beyond the flange; K on the hand, turned by -45 deg about z as Desk sets it,
        // 0.1034 m out.
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, -std::f64::consts::FRAC_PI_4);
        let hand: Pose<Flange, Stiffness> = Pose::new(Vector3::new(0.0, 0.0, 0.1034), turn);
        let tool: Pose<Flange, Tool> =
            Pose::new(Vector3::new(0.0, 0.0, 0.2), UnitQuaternion::identity());
        // The surface pushes the tool with 15 N along -z of the tool and 2 N along +x.
        let on_tool: Wrench<Tool> = Wrench::new(Vector3::new(2.0, 0.0, -15.0), Vector3::zeros());
        let k_from_tool = hand.inverse() * tool;
        let at_k = k_from_tool.transform_wrench(&on_tool).vector();
        let state = RobotState {
            f_t_ee: columns(&hand),
            ee_t_k: columns(&Pose::<Stiffness, Stiffness>::identity()),
            k_f_ext_hat_k: (-at_k).into(),
            ..RobotState::default()
        };
        let found = tool_wrench(&state, &tool).vector();
        assert!((found - on_tool.vector()).amax() < 1e-12, "{found}");
    }
}
