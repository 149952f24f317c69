//! The arm of a torque-controlled cell with what hangs on its flange: for the plant as it is, for
//! the law as the cell file says.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Arm, ModelData, Payload};

use crate::plant_config::ToolConfig;
use crate::plant_error::PlantError;

/// The built-in model `robot` with the tool's payload; with `as_it_is`, the payload's error is in
/// it too.
///
/// # Errors
/// An unknown robot, or one with another number of joints.
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
