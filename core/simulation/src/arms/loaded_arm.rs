//! Model of a torque-controlled arm with the payload on its flange: the true payload for the plant,
//! the one stated in the cell file for the law.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Arm, ModelData, Payload};

use crate::plant_error::PlantError;
use crate::tool::ToolConfig;
use crate::true_value::True;

/// Number of joints of the built-in model `robot`.
///
/// # Errors
/// An unknown robot.
pub fn joints_of(robot: &str) -> Result<usize, PlantError> {
    Ok(ModelData::builtin(robot)?.dof)
}

/// The built-in model `robot` with the payload that the cell file states, for laws and estimators.
///
/// # Errors
/// An unknown robot, or one with a different number of joints.
pub fn stated_arm<const N: usize>(robot: &str, tool: &ToolConfig) -> Result<Arm<N>, PlantError> {
    loaded_arm(robot, tool, 0.0)
}

/// The built-in model `robot` with the payload that is really on it, for the plant.
///
/// # Errors
/// An unknown robot, or one with a different number of joints.
pub(crate) fn true_arm<const N: usize>(
    robot: &str,
    tool: &ToolConfig,
) -> Result<True<Arm<N>>, PlantError> {
    Ok(True::new(loaded_arm(robot, tool, 1.0)?))
}

/// `share` is that of the payload's error.
fn loaded_arm<const N: usize>(
    robot: &str,
    tool: &ToolConfig,
    share: f64,
) -> Result<Arm<N>, PlantError> {
    let model = Arm::<N>::new(&ModelData::builtin(robot)?)?;
    let (payload, error) = (&tool.payload, &tool.payload_error);
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
