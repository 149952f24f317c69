//! Model of a torque-controlled arm with the payload on its flange: the true payload for the plant,
//! the one stated in the cell file for the law.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Arm, ModelData, Payload};

use crate::plant_error::PlantError;
use crate::tool::ToolConfig;

/// Number of joints of the built-in model `robot`.
///
/// # Errors
/// An unknown robot.
pub fn joints_of(robot: &str) -> Result<usize, PlantError> {
    Ok(ModelData::builtin(robot)?.dof)
}

/// The built-in model `robot` with the tool's payload. If `as_it_is` is set, it includes the
/// payload's error.
///
/// # Errors
/// An unknown robot, or one with a different number of joints.
pub fn loaded_arm<const N: usize>(
    robot: &str,
    tool: &ToolConfig,
    as_it_is: bool,
) -> Result<Arm<N>, PlantError> {
    let model = Arm::<N>::new(&ModelData::builtin(robot)?)?;
    let (payload, error) = (&tool.payload, &tool.payload_error);
    let share = if as_it_is { 1.0 } else { 0.0 };
    let mass_kg = payload.mass_kg + share * error.mass_kg;
    if mass_kg <= 0.0 {
        return Ok(model);
    }
    let com = Vector3::from(payload.com_in_sensor_m) + Vector3::from(error.com_in_sensor_m) * share;
    let flange_from_sensor = tool.flange_from_sensor.isometry();
    let turn = flange_from_sensor.rotation.to_rotation_matrix();
    let inertia = Matrix3::from_diagonal(&payload.inertia_kg_m2.into());
    Ok(model.with_payload(&Payload {
        mass_kg,
        com_in_flange_m: flange_from_sensor.transform_point(&com.into()).coords,
        inertia_kg_m2: turn * inertia * turn.transpose(),
    }))
}
