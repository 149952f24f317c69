//! A scenario fitted to a cell file: its surface, contact, noise and start stay; arm, control rate
//! and tool become the cell's.

use nalgebra::{UnitQuaternion, Vector3};
use tangent_mechanics::{Base, Tool};
use tangent_rtde::settings::series_of;
use tangent_runtime::CellConfig;
use tangent_runtime::config::PoseConfig;
use tangent_simulation::{Scenario, ServoConfig, ToolConfig};

/// Two mountings that differ by less are the same, m and rad: a file may write a turn in two ways.
const SAME: f64 = 1e-9;

/// Replaces the scenario's arm with the cell's, at the control rate of that arm's series.
pub fn take_arm(played: &mut Scenario, config: &CellConfig) {
    let model = &config.robot.model;
    match played {
        Scenario::Admittance(scenario) if scenario.plant.robot != *model => {
            let plant = &mut scenario.plant;
            plant.robot.clone_from(model);
            if let Some(series) = series_of(model) {
                plant.arm = of_period(&plant.arm, series.period_s());
            }
        }
        Scenario::Admittance(_) => {}
        Scenario::ObjectPose(scenario) => scenario.plant.robot.clone_from(model),
        Scenario::VisuoTactile(scenario) => scenario.plant.robot.clone_from(model),
    }
}

/// Replaces the scenario's tool with the cell's. The deviation of the true payload
/// (`payload_error`) stays.
pub fn take_tool(played: &mut Scenario, config: &CellConfig) {
    let tool = played.tool_mut();
    take_mounting(tool, config);
    tool.payload.mass_kg = config.tool.mass_kg;
    tool.payload.com_in_sensor_m = config.tool.com_in_sensor_m;
    if config.tool.inertia_kg_m2 != [0.0; 3] {
        tool.payload.inertia_kg_m2 = config.tool.inertia_kg_m2;
    }
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
