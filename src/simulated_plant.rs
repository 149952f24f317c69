//! A scenario fitted to a cell file: its surface, contact, noise and start stay; arm, control rate
//! and tool become the cell's.

use nalgebra::{UnitQuaternion, Vector3};
use tangent_mechanics::{Base, Tool};
use tangent_rtde::settings::series_of;
use tangent_runtime::CellConfig;
use tangent_runtime::config::PoseConfig;
use tangent_simulation::{ObjectPlant, Plant, PlantError, ServoConfig, TactilePlant, ToolConfig};

use crate::scenarios::Played;

/// Two mountings that differ by less are the same, m and rad: a file may write a turn in two ways.
const SAME: f64 = 1e-9;

/// The cell's arm in place of the scenario's, at the control rate of its series.
pub fn take_arm(played: &mut Played, config: &CellConfig) {
    let model = &config.robot.model;
    match played {
        Played::Normals(scenario) if scenario.plant.robot != *model => {
            let plant = &mut scenario.plant;
            plant.robot.clone_from(model);
            if let Some(series) = series_of(model) {
                plant.arm = of_period(&plant.arm, series.period_s());
            }
        }
        Played::Normals(_) => {}
        Played::Object(scenario) => scenario.plant.robot.clone_from(model),
        Played::Tactile(scenario) => scenario.plant.robot.clone_from(model),
    }
}

/// The cell's tool in place of the scenario's. What truly hangs there beyond that (`payload_error`)
/// stays.
pub fn take_tool(played: &mut Played, config: &CellConfig) {
    let tool = match played {
        Played::Normals(scenario) => &mut scenario.plant.tool,
        Played::Object(scenario) => &mut scenario.plant.tool,
        Played::Tactile(scenario) => &mut scenario.plant.tool,
    };
    take_mounting(tool, config);
    tool.payload.mass_kg = config.tool.mass_kg;
    tool.payload.com_in_sensor_m = config.tool.com_in_sensor_m;
    if config.tool.inertia_kg_m2 != [0.0; 3] {
        tool.payload.inertia_kg_m2 = config.tool.inertia_kg_m2;
    }
}

/// Where the arm stands at first, rad.
///
/// # Errors
/// A plant that cannot be built, for instance a start pose out of the arm's reach.
pub fn start(played: &Played) -> Result<Vec<f64>, PlantError> {
    Ok(match played {
        Played::Normals(scenario) => {
            let plant = Plant::new(&scenario.plant, scenario.seed)?;
            plant.joints().as_slice().to_vec()
        }
        Played::Object(scenario) => {
            let corners = scenario.estimation.target.corners();
            let plant = ObjectPlant::new(&scenario.plant, corners, scenario.seed)?;
            plant.arm().q.as_slice().to_vec()
        }
        Played::Tactile(scenario) => {
            let plant = TactilePlant::new(&scenario.plant, scenario.seed)?;
            plant.measured().q.as_slice().to_vec()
        }
    })
}

/// The servo of the series with this period, with the encoders that the scenario has.
fn of_period(servo: &ServoConfig, period_s: f64) -> ServoConfig {
    if (servo.period_s - period_s).abs() < SAME {
        return servo.clone();
    }
    let series = if period_s < ServoConfig::cb3().period_s {
        ServoConfig::e_series()
    } else {
        ServoConfig::cb3()
    };
    ServoConfig {
        encoder_resolution_rad: servo.encoder_resolution_rad,
        velocity_resolution_rad_per_s: servo.velocity_resolution_rad_per_s,
        ..series
    }
}

fn take_mounting(tool: &mut ToolConfig, config: &CellConfig) {
    take_pose(
        &mut tool.flange_from_sensor,
        &config.sensor.flange_from_sensor,
    );
    take_pose(&mut tool.flange_from_tool, &config.tool.flange_from_tool);
}

fn take_pose(pose: &mut tangent_simulation::PoseConfig, own: &PoseConfig) {
    let (found, wanted) = (pose.isometry(), own.pose::<Base, Tool>());
    let near = (found.translation.vector - wanted.translation()).norm() < SAME
        && found.rotation.angle_to(&wanted.rotation()) < SAME;
    if near {
        return;
    }
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(own.rotation_vector_rad));
    let (roll, pitch, yaw) = turn.euler_angles();
    pose.position_m = own.translation_m;
    pose.roll_pitch_yaw_rad = [roll, pitch, yaw];
}
