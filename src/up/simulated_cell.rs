//! The cell file that fits a simulated cell: what a person would have measured and written down.

use anyhow::{Context, Result};
use nalgebra::{UnitQuaternion, Vector3};
use tangent_mechanics::{Arm, ModelData};
use tangent_runtime::CellConfig;
use tangent_runtime::config::{CameraConfig, CameraKind, Focal, Law, PoseConfig, WrenchSource};
use tangent_simulation::{NormalSource, ObjectScenario, Scenario, TactileScenario};
use toml::Table;

use crate::cli::Up;
use crate::output::bad_usage;

/// Left out around the tool in depth images, m: pixels at its edge float.
const TOOL_MARGIN_M: f64 = 0.004;
/// A simulated Franka as its cell file has it.
const FRANKA: &str = include_str!("../../deploy/cell.franka.toml");
/// Records per second of the force sensor beside a torque-controlled arm: two per period.
const TORQUE_SENSOR_HZ: f64 = 2000.0;
/// Jitter of the wrench that a laptop's threads may have, s.
const WRENCH_JITTER_S: f64 = 0.006;
/// A laptop that draws the images too finds their corners late at times, s.
const VISION_PATIENCE_S: f64 = 0.25;
/// The controller's share of the cell's limits; see its own `SHARE`.
const LIMIT_SHARE: f64 = 0.9;

/// For a scenario of an arm that takes velocities.
///
/// # Errors
/// A port offset that leads past the last port.
pub fn of_normals(mut cell: CellConfig, scenario: &Scenario, args: &Up) -> Result<CellConfig> {
    let tool = &scenario.plant.tool;
    cell.robot.model.clone_from(&scenario.plant.robot);
    on_this_machine(&mut cell, args)?;
    cell.sensor.flange_from_sensor = pose(&tool.flange_from_sensor);
    cell.sensor.filter_cutoff_hz = scenario.sensing.filter_cutoff_hz;
    cell.tool.flange_from_tool = pose(&tool.flange_from_tool);
    cell.tool.mass_kg = tool.payload.mass_kg;
    cell.tool.com_in_sensor_m = tool.payload.com_in_sensor_m;
    cell.base = scenario.base;
    cell.controller.preset.clone_from(&scenario.controller);
    cell.controller.settings.clone_from(&scenario.control);
    run_estimators(&mut cell, &scenario.task.estimators, true);
    cell.estimators.settings.insert(
        tangent_estimator::ALL.to_owned(),
        Table::try_from(scenario.estimation)?,
    );
    Ok(cell)
}

/// For a scenario of an arm that takes torques, an object of known shape and a camera.
///
/// # Errors
/// A port offset that leads past the last port, or an unknown arm.
pub fn of_object(mut cell: CellConfig, scenario: &ObjectScenario, args: &Up) -> Result<CellConfig> {
    let plant = &scenario.plant;
    let tool = &plant.tool;
    cell.robot.model.clone_from(&plant.robot);
    on_this_machine(&mut cell, args)?;
    cell.sensor.flange_from_sensor = pose(&tool.flange_from_sensor);
    cell.sensor.filter_cutoff_hz = scenario.sensing.filter_cutoff_hz;
    cell.sensor.rate_hz = TORQUE_SENSOR_HZ;
    cell.sensor.tool_rate_hz = TORQUE_SENSOR_HZ;
    cell.sensor.raw_rate_hz = 0.5 * TORQUE_SENSOR_HZ;
    cell.tool.flange_from_tool = pose(&tool.flange_from_tool);
    cell.tool.mass_kg = tool.payload.mass_kg;
    cell.tool.com_in_sensor_m = tool.payload.com_in_sensor_m;
    cell.tool.inertia_kg_m2 = tool.payload.inertia_kg_m2;
    let camera = &plant.camera;
    cell.camera = Some(CameraConfig {
        topic: tangent_schemas::topics::SIMULATED_IMAGE.key().to_owned(),
        info_topic: None,
        size_px: Some(camera.image_px.map(|x| x as u32)),
        focal_px: Some(Focal::Square(camera.focal_px)),
        principal_px: Some(camera.principal_px),
        pixel_m: camera.pixel_m,
        flange_from_camera: pose(&camera.flange_from_camera),
        pass_on_hz: 5.0,
        recording: None,
        recording_topic: None,
        kind: CameraKind::Target,
    });
    let limits = &scenario.limits;
    let model = ModelData::builtin(&plant.robot).map_err(bad_usage)?;
    let speeds = Arm::<6>::new(&model).context("arm")?.limits().velocity;
    cell.limits.joint_speed_max_rad_per_s = speeds
        .iter()
        .map(|speed| speed * limits.joint_speed_share / LIMIT_SHARE)
        .collect();
    cell.limits.joint_acceleration_max_rad_per_s2 =
        vec![limits.joint_acceleration_max_rad_per_s2 / LIMIT_SHARE];
    cell.limits.tool_speed_max_m_per_s = limits.speed_max_m_per_s / LIMIT_SHARE;
    cell.limits.tool_turn_rate_max_rad_per_s = limits.turn_rate_max_rad_per_s / LIMIT_SHARE;
    cell.limits.force_max_n = limits.force_max_n;
    cell.limits.torque_max_nm = limits.torque_max_nm;
    cell.limits.workspace_min_m = limits.workspace_min_m;
    cell.limits.workspace_max_m = limits.workspace_max_m;
    cell.controller.law = Law::HybridDynamics;
    cell.controller.preset.clone_from(&scenario.controller);
    cell.controller.settings.clone_from(&scenario.control);
    allow_jitter(&mut cell.controller.settings);
    run_estimators(&mut cell, &scenario.task.estimators, false);
    cell.estimators.settings.clear();
    let mut estimation = scenario.estimation.clone();
    estimation.vision_patience_s = estimation.vision_patience_s.max(VISION_PATIENCE_S);
    for name in &scenario.task.estimators {
        cell.estimators
            .settings
            .insert(name.clone(), Table::try_from(&estimation)?);
    }
    Ok(cell)
}

/// For a scenario of a Franka that feels through its joints.
///
/// # Errors
/// A port offset that leads past the last port.
pub fn of_tactile(
    mut cell: CellConfig,
    scenario: &TactileScenario,
    args: &Up,
) -> Result<CellConfig> {
    let shipped = CellConfig::parse("deploy/cell.franka.toml", FRANKA).map_err(bad_usage)?;
    let tool = &scenario.plant.tool;
    cell.robot = shipped.robot;
    cell.sensor = shipped.sensor;
    cell.robot.model.clone_from(&scenario.plant.robot);
    on_this_machine(&mut cell, args)?;
    cell.sensor.flange_from_sensor = pose(&tool.flange_from_sensor);
    cell.tool.flange_from_tool = pose(&tool.flange_from_tool);
    cell.tool.mass_kg = tool.payload.mass_kg;
    cell.tool.com_in_sensor_m = tool.payload.com_in_sensor_m;
    cell.tool.inertia_kg_m2 = tool.payload.inertia_kg_m2;
    if let Some(franka) = &mut cell.robot.franka {
        franka.tool_inertia_kg_m2 = tool.payload.inertia_kg_m2;
        // Of `evaluate`'s delay one period is the interface's own.
        franka.delay_periods = scenario.plant.arm.delay_periods.saturating_sub(1);
    }
    let limits = &scenario.limits;
    cell.limits = shipped.limits;
    cell.limits.force_max_n = limits.force_max_n;
    cell.limits.torque_max_nm = limits.torque_max_nm;
    cell.controller.law = Law::UnifiedForceImpedance;
    cell.controller.preset.clone_from(&scenario.controller);
    cell.controller.settings.clone_from(&scenario.control);
    allow_jitter(&mut cell.controller.settings);
    cell.estimators.wrench = WrenchSource::Law;
    run_estimators(&mut cell, &scenario.task.estimators, false);
    cell.estimators.settings.clear();
    cell.estimators.settings.insert(
        tangent_estimator::ALL.to_owned(),
        Table::try_from(scenario.estimation)?,
    );
    if scenario.plant.normals_from == NormalSource::Depth {
        see_depth(&mut cell, scenario)?;
    }
    Ok(cell)
}

/// The depth camera and the estimator that reads it.
fn see_depth(cell: &mut CellConfig, scenario: &TactileScenario) -> Result<()> {
    let camera = &scenario.plant.depth_camera;
    let intrinsics = camera.intrinsics();
    cell.camera = Some(CameraConfig {
        topic: tangent_schemas::topics::SIMULATED_IMAGE.key().to_owned(),
        recording: None,
        recording_topic: None,
        kind: CameraKind::Depth,
        info_topic: None,
        size_px: Some(camera.sent_px().map(|n| n as u32)),
        focal_px: Some(Focal::Each([intrinsics.fx_px, intrinsics.fy_px])),
        principal_px: Some([intrinsics.cx_px, intrinsics.cy_px]),
        pixel_m: 3e-6,
        flange_from_camera: pose(&camera.flange_from_camera),
        pass_on_hz: 2.0,
    });
    let mut settings = Table::new();
    settings.insert(
        "fit".to_owned(),
        Table::try_from(scenario.plant.depth_normal)?.into(),
    );
    if let Some(tool) = &camera.tool {
        let mut rod = Table::new();
        rod.insert(
            "radius_m".to_owned(),
            (tool.radius_m + TOOL_MARGIN_M).into(),
        );
        rod.insert("length_m".to_owned(), tool.length_m.into());
        settings.insert("tool".to_owned(), rod.into());
    }
    let name = tangent_estimation::depth_normal::DEPTH_NORMAL.to_owned();
    cell.estimators.settings.insert(name.clone(), settings);
    cell.estimators.run.push(name);
    Ok(())
}

/// Threads of one laptop are less punctual than the closed loop; a scenario that says otherwise is heard.
fn allow_jitter(settings: &mut Table) {
    let patience = settings
        .entry("patience")
        .or_insert_with(|| Table::new().into());
    if let Some(patience) = patience.as_table_mut() {
        patience
            .entry("wrench_jitter_s")
            .or_insert(WRENCH_JITTER_S.into());
    }
}

fn run_estimators(cell: &mut CellConfig, names: &[String], others_too: bool) {
    if !others_too {
        cell.estimators.run.clear();
    }
    if let Some(first) = names.first() {
        cell.estimators.active.clone_from(first);
    }
    for name in names {
        if !cell.estimators.run.contains(name) {
            cell.estimators.run.push(name.clone());
        }
    }
}

fn on_this_machine(cell: &mut CellConfig, args: &Up) -> Result<()> {
    cell.robot.address = "127.0.0.1".to_owned();
    cell.sensor.address = "127.0.0.1".to_owned();
    cell.robot.port_offset = offset(cell.robot.port_offset, args.port_offset)?;
    cell.sensor.port_offset = offset(cell.sensor.port_offset, args.port_offset)?;
    if args.port_offset > 0 {
        let protocol = if cell.zenoh.tls.is_some() {
            "quic"
        } else {
            "tcp"
        };
        let port = offset(7447, args.port_offset)?;
        let endpoint = format!("{protocol}/127.0.0.1:{port}");
        cell.zenoh.listen = vec![endpoint.clone()];
        cell.zenoh.connect = vec![endpoint];
    }
    Ok(())
}

fn pose(p: &tangent_simulation::PoseConfig) -> PoseConfig {
    let [roll, pitch, yaw] = p.roll_pitch_yaw_rad;
    let turn: Vector3<f64> = UnitQuaternion::from_euler_angles(roll, pitch, yaw).scaled_axis();
    PoseConfig {
        translation_m: p.position_m,
        rotation_vector_rad: turn.into(),
    }
}

fn offset(port: u16, by: u16) -> Result<u16> {
    // The highest port in use is the sensor's, 49152.
    match port.checked_add(by) {
        Some(sum) if sum <= u16::MAX - 49_152 || port >= 7447 => Ok(sum),
        _ => Err(bad_usage(format!(
            "--port-offset {by}: must keep every port below 65536; 0 to 16383 is allowed"
        ))),
    }
}
