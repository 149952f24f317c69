//! The cell file that fits a scenario, with the values that a user would measure and write down.

use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;
use tangent_mechanics::{Arm, ModelData};
use tangent_runtime::CellConfig;
use tangent_simulation::depth_camera::DepthCameraConfig;
use tangent_simulation::{
    AdmittanceScenario, NormalSource, ObjectScenario, Scenario, VisuoTactileScenario,
};
use toml::Table;

use crate::cell_keys::{get, set};
use crate::error::SimulatedCellError;

/// Result of writing into a cell file.
type Result<T> = std::result::Result<T, SimulatedCellError>;

/// Left out around the tool in depth images, m: pixels at its edge float.
const TOOL_MARGIN_M: f64 = 0.004;
/// A simulated Franka as its cell file has it.
const FRANKA: &str = include_str!("../../../deploy/cell.franka.toml");
/// Records per second of the force sensor beside a torque-controlled arm: two per period.
const TORQUE_SENSOR_HZ: f64 = 2000.0;
/// Jitter of the wrench that a laptop's threads may have, s.
const WRENCH_JITTER_S: f64 = 0.006;
/// A laptop that draws the images too finds their corners late at times, s.
const VISION_PATIENCE_S: f64 = 0.25;
/// The controller's share of the cell's limits; see its own `SHARE`.
const LIMIT_SHARE: f64 = 0.9;

/// Writes the scenario's plant, law and estimators into `cell`.
///
/// # Errors
/// An unknown arm.
pub fn write(cell: &mut Table, base: &CellConfig, played: &Scenario) -> Result<()> {
    match played {
        Scenario::Admittance(scenario) => of_admittance(cell, base, scenario),
        Scenario::ObjectPose(scenario) => of_object(cell, scenario),
        Scenario::VisuoTactile(scenario) => of_visuo_tactile(cell, scenario),
    }
}

fn of_admittance(cell: &mut Table, base: &CellConfig, scenario: &AdmittanceScenario) -> Result<()> {
    set(cell, "robot.model", &scenario.plant.robot)?;
    tool(cell, &scenario.plant.tool)?;
    set(
        cell,
        "sensor.filter_cutoff_hz",
        scenario.sensing.filter_cutoff_hz,
    )?;
    set(cell, "base", scenario.base)?;
    if let Some(camera) = &scenario.plant.depth_camera {
        camera_with_depth(cell, camera)?;
    }
    set(cell, "controller.preset", &scenario.controller)?;
    set(cell, "controller.settings", &scenario.control)?;
    let mut run = base.estimators.run.clone();
    let named = &scenario.task.estimators;
    run.extend(
        named
            .iter()
            .filter(|n| !base.estimators.run.contains(n))
            .cloned(),
    );
    estimators(cell, &run, named.first())?;
    set(
        cell,
        &format!("estimators.settings.{}", tangent_estimator::ALL),
        scenario.estimation,
    )
}

fn of_object(cell: &mut Table, scenario: &ObjectScenario) -> Result<()> {
    let plant = &scenario.plant;
    set(cell, "robot.model", &plant.robot)?;
    tool(cell, &plant.tool)?;
    set(
        cell,
        "sensor.filter_cutoff_hz",
        scenario.sensing.filter_cutoff_hz,
    )?;
    set(cell, "sensor.rate_hz", TORQUE_SENSOR_HZ)?;
    set(cell, "sensor.tool_rate_hz", TORQUE_SENSOR_HZ)?;
    set(cell, "sensor.raw_rate_hz", 0.5 * TORQUE_SENSOR_HZ)?;
    set(cell, "tool.inertia_kg_m2", plant.tool.payload.inertia_kg_m2)?;
    target_camera(cell, scenario)?;
    let limits = &scenario.limits;
    let model = ModelData::builtin(&plant.robot).map_err(SimulatedCellError::ArmName)?;
    let arm = Arm::<6>::new(&model).map_err(SimulatedCellError::Arm)?;
    let speeds = arm.limits().velocity;
    let speeds: Vec<f64> = speeds
        .iter()
        .map(|speed| speed * limits.joint_speed_share / LIMIT_SHARE)
        .collect();
    let acceleration = limits.joint_acceleration_max_rad_per_s2 / LIMIT_SHARE;
    let turn_rate = limits.turn_rate_max_rad_per_s / LIMIT_SHARE;
    set(cell, "limits.joint_speed_max_rad_per_s", speeds)?;
    set(
        cell,
        "limits.joint_acceleration_max_rad_per_s2",
        [acceleration],
    )?;
    set(
        cell,
        "limits.tool_speed_max_m_per_s",
        limits.speed_max_m_per_s / LIMIT_SHARE,
    )?;
    set(cell, "limits.tool_turn_rate_max_rad_per_s", turn_rate)?;
    contact_limits(cell, limits)?;
    set(cell, "limits.workspace_min_m", limits.workspace_min_m)?;
    set(cell, "limits.workspace_max_m", limits.workspace_max_m)?;
    set(cell, "controller.law", "hybrid_dynamics")?;
    law(cell, &scenario.controller, &scenario.control)?;
    let named = &scenario.task.estimators;
    estimators(cell, named, named.first())?;
    let mut estimation = scenario.estimation.clone();
    estimation.vision_patience_s = estimation.vision_patience_s.max(VISION_PATIENCE_S);
    set(cell, "estimators.settings", Table::new())?;
    for name in named {
        set(cell, &format!("estimators.settings.{name}"), &estimation)?;
    }
    Ok(())
}

fn of_visuo_tactile(cell: &mut Table, scenario: &VisuoTactileScenario) -> Result<()> {
    let shipped = FRANKA
        .parse::<Table>()
        .map_err(|source| SimulatedCellError::Shipped {
            file: "deploy/cell.franka.toml",
            source,
        })?;
    for section in ["robot", "sensor", "limits"] {
        set(cell, section, shipped.get(section))?;
    }
    let plant = &scenario.plant;
    set(cell, "robot.model", &plant.robot)?;
    tool(cell, &plant.tool)?;
    let inertia = plant.tool.payload.inertia_kg_m2;
    set(cell, "tool.inertia_kg_m2", inertia)?;
    set(cell, "robot.franka.tool_inertia_kg_m2", inertia)?;
    // Of `evaluate`'s delay one period is the interface's own.
    let delay = plant.arm.delay_periods.saturating_sub(1);
    set(cell, "robot.franka.delay_periods", delay)?;
    contact_limits(cell, &scenario.limits)?;
    set(cell, "controller.law", "unified_force_impedance")?;
    law(cell, &scenario.controller, &scenario.control)?;
    set(cell, "estimators.wrench", "law")?;
    set(cell, "estimators.settings", Table::new())?;
    set(
        cell,
        &format!("estimators.settings.{}", tangent_estimator::ALL),
        scenario.estimation,
    )?;
    let named = &scenario.task.estimators;
    let mut run = named.clone();
    if plant.normals_from == NormalSource::Depth {
        depth_camera(cell, scenario)?;
        run.push(tangent_estimation::depth_normal::DEPTH_NORMAL.to_owned());
    }
    estimators(cell, &run, named.first())
}

fn tool(cell: &mut Table, tool: &tangent_simulation::ToolConfig) -> Result<()> {
    mounting(cell, "sensor.flange_from_sensor", &tool.flange_from_sensor)?;
    mounting(cell, "tool.flange_from_tool", &tool.flange_from_tool)?;
    set(cell, "tool.mass_kg", tool.payload.mass_kg)?;
    set(cell, "tool.com_in_sensor_m", tool.payload.com_in_sensor_m)
}

fn contact_limits(cell: &mut Table, limits: &tangent_control::Limits) -> Result<()> {
    set(cell, "limits.force_max_n", limits.force_max_n)?;
    set(cell, "limits.torque_max_nm", limits.torque_max_nm)
}

/// Preset and settings of a torque law. Threads of one laptop are less punctual than the closed
/// loop; a value in the scenario takes precedence.
fn law(cell: &mut Table, preset: &str, settings: &Table) -> Result<()> {
    set(cell, "controller.preset", preset)?;
    set(cell, "controller.settings", settings)?;
    let jitter = "controller.settings.patience.wrench_jitter_s";
    if get(cell, jitter).is_none() {
        set(cell, jitter, WRENCH_JITTER_S)?;
    }
    Ok(())
}

fn estimators(cell: &mut Table, run: &[String], active: Option<&String>) -> Result<()> {
    if let Some(active) = active {
        set(cell, "estimators.active", active)?;
    }
    set(cell, "estimators.run", run)
}

/// The camera that sees the target.
pub fn target_camera(cell: &mut Table, scenario: &ObjectScenario) -> Result<()> {
    let camera = &scenario.plant.camera;
    let mut own = Table::new();
    let topic = tangent_schemas::topics::SIMULATED_IMAGE.key();
    set(&mut own, "topic", topic)?;
    set(&mut own, "kind", "target")?;
    set(&mut own, "size_px", camera.image_px.map(|x| x as u32))?;
    set(&mut own, "focal_px", camera.focal_px)?;
    set(&mut own, "principal_px", camera.principal_px)?;
    set(&mut own, "pixel_m", camera.pixel_m)?;
    set(&mut own, "pass_on_hz", 5.0)?;
    mounting(&mut own, "flange_from_camera", &camera.flange_from_camera)?;
    set(cell, "camera", own)
}

/// The depth camera and what the estimator that reads it has to know.
pub fn depth_camera(cell: &mut Table, scenario: &VisuoTactileScenario) -> Result<()> {
    camera_with_depth(cell, &scenario.plant.depth_camera)?;
    set(cell, &depth_key("fit"), scenario.plant.depth_normal)
}

/// Key of a setting for what reads the depth images.
fn depth_key(rest: &str) -> String {
    let name = tangent_estimation::depth_normal::DEPTH_NORMAL;
    format!("estimators.settings.{name}.{rest}")
}

/// The `[camera]` section of a depth camera, and the tool in its view.
pub fn camera_with_depth(cell: &mut Table, camera: &DepthCameraConfig) -> Result<()> {
    let intrinsics = camera.intrinsics();
    let mut own = Table::new();
    let topic = tangent_schemas::topics::SIMULATED_IMAGE.key();
    set(&mut own, "topic", topic)?;
    set(&mut own, "kind", "depth")?;
    set(&mut own, "size_px", camera.sent_px().map(|n| n as u32))?;
    set(&mut own, "focal_px", [intrinsics.fx_px, intrinsics.fy_px])?;
    set(
        &mut own,
        "principal_px",
        [intrinsics.cx_px, intrinsics.cy_px],
    )?;
    set(&mut own, "pixel_m", 3e-6)?;
    set(&mut own, "pass_on_hz", 2.0)?;
    mounting(&mut own, "flange_from_camera", &camera.flange_from_camera)?;
    set(cell, "camera", own)?;
    if let Some(tool) = &camera.tool {
        let radius_m = tool.radius_m + TOOL_MARGIN_M;
        set(cell, &depth_key("tool.radius_m"), radius_m)?;
        set(cell, &depth_key("tool.length_m"), tool.length_m)?;
    }
    Ok(())
}

fn mounting(cell: &mut Table, key: &str, p: &tangent_simulation::PoseConfig) -> Result<()> {
    let [roll, pitch, yaw] = p.roll_pitch_yaw_rad;
    let turn: Vector3<f64> = UnitQuaternion::from_euler_angles(roll, pitch, yaw).scaled_axis();
    #[derive(Serialize)]
    struct Pose {
        translation_m: [f64; 3],
        rotation_vector_rad: [f64; 3],
    }
    let pose = Pose {
        translation_m: p.position_m,
        rotation_vector_rad: turn.into(),
    };
    set(cell, key, pose)
}
