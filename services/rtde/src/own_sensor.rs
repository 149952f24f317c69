//! The force that a UR arm itself feels, in the project's frames and signs: by the force/torque
//! sensor of an e-Series arm, or from the currents of a CB3 arm's motors.

use tangent_mechanics::{Arm, Flange, Joints, Wrench};
use tangent_runtime::config::UrReading;

/// Wrench of the environment on the flange, at the flange, flange axes, N and Nm. `values` is the
/// RTDE output `reading`, at joint angles `q` (rad).
///
/// An e-Series controller gives both readings at the flange: `ft_raw_wrench` in the axes of the
/// flange, with the weight of the payload, and `actual_TCP_force` in the axes of the base, without
/// it. A CB3 has no sensor, and estimates the latter: its force is given here as any other, and its
/// torque is about the tool centre point that is set on the robot.
pub fn flange_wrench(
    reading: UrReading,
    values: &[f64; 6],
    arm: &Arm<6>,
    q: &Joints<6>,
) -> Wrench<Flange> {
    let given = Wrench::<Flange>::from_vector(&(*values).into());
    match reading {
        UrReading::FtRawWrench => given,
        UrReading::ActualTcpForce => {
            let flange_from_base = arm.base_from_flange(q).rotation().inverse();
            Wrench::new(
                flange_from_base * given.force,
                flange_from_base * given.torque,
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use tangent_mechanics::ModelData;

    use super::*;

    /// A table under a tool that points down pushes up, against the tool's z, with either reading.
    #[test]
    fn pressing_on_a_table_gives_a_force_against_the_flange() {
        let arm = Arm::<6>::new(&ModelData::builtin("ur5e").unwrap()).unwrap();
        let q = arm.home();
        let base_from_flange = arm.base_from_flange(&q);
        let up = Vector3::new(0.0, 0.0, 12.0);
        let torque = Vector3::new(0.3, -0.2, 0.1);
        let on_flange = Wrench::<Flange>::new(
            base_from_flange.rotation().inverse() * up,
            base_from_flange.rotation().inverse() * torque,
        );
        let in_base = [up.x, up.y, up.z, torque.x, torque.y, torque.z];
        let found = flange_wrench(UrReading::ActualTcpForce, &in_base, &arm, &q);
        assert!((found.vector() - on_flange.vector()).amax() < 1e-12);
        let raw: [f64; 6] = on_flange.vector().into();
        let found = flange_wrench(UrReading::FtRawWrench, &raw, &arm, &q);
        assert_eq!(found.vector(), on_flange.vector());
    }
}
