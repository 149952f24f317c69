//! Runs a given cell file against the simulator: the scenario is fitted to the cell, simulated
//! devices replace the real ones, and settings that cannot be simulated are named.

use tangent_runtime::CellConfig;
use tangent_runtime::config::{Law, RobotDriver, SensorDriver};
use tangent_simulation::Scenario;
use toml::{Table, Value};

use crate::cell_keys::{get, remove, set};
use crate::error::SimulatedCellError;
use crate::{scenario_cell, simulated_plant};

/// Ports by key: that of the cell, and where a simulated one listens.
fn ports(cell: &CellConfig) -> [(&'static str, u16, u16); 6] {
    let (robot, sensor) = (&cell.robot, &cell.sensor);
    [
        ("robot.rtde_port", robot.rtde_port, 30_004),
        ("robot.script_port", robot.script_port, 30_001),
        ("robot.dashboard_port", robot.dashboard_port, 29_999),
        ("robot.franka.fci_port", robot.franka().fci_port, 1337),
        ("sensor.rdt_port", sensor.rdt_port, 49_152),
        ("sensor.http_port", sensor.http_port, 8080),
    ]
}

/// The address of everything simulated.
const HERE: &str = "127.0.0.1";

/// Fits the scenario to the cell: its arm, at its control rate, with its tool.
///
/// # Errors
/// A cell that this scenario cannot be played with, or an arm of the user's own, which no simulator
/// knows.
pub fn fit(cell: &CellConfig, played: &mut Scenario) -> Result<(), SimulatedCellError> {
    let (law, driver) = match played {
        Scenario::Admittance(_) => (Law::HybridAdmittance, RobotDriver::Rtde),
        Scenario::ObjectPose(_) => (Law::HybridDynamics, RobotDriver::Rtde),
        Scenario::VisuoTactile(_) => (Law::UnifiedForceImpedance, RobotDriver::Franka),
    };
    if cell.controller.law != law || cell.robot.driver != driver {
        return Err(SimulatedCellError::Mismatch {
            cell: cell.cell.name.clone(),
            law: cell.controller.law,
            driver: cell.robot.driver,
            scenario: played.name().to_owned(),
            scenario_law: law,
            scenario_driver: driver,
        });
    }
    if let Some(file) = &cell.robot.model_file {
        return Err(SimulatedCellError::OwnArm {
            cell: cell.cell.name.clone(),
            file: file.clone(),
        });
    }
    simulated_plant::take_arm(played, cell);
    simulated_plant::take_tool(played, cell);
    Ok(())
}

/// Replaces values of `cell` by those of the simulation. Returns each replaced key with the reason.
///
/// # Errors
/// A value that cannot be written.
pub fn write(
    cell: &mut Table,
    base: &CellConfig,
    played: &Scenario,
) -> Result<Vec<String>, SimulatedCellError> {
    let mut unused = Vec::new();
    for (key, what) in [
        ("robot.address", "the arm is simulated here"),
        ("sensor.address", "the sensor is simulated here"),
    ] {
        let own = get(cell, key).and_then(Value::as_str).unwrap_or_default();
        // A Franka has no box, and its file says so; neither has an arm with its own sensor.
        if own != HERE && own != "none" && !own.is_empty() {
            unused.push(format!("{key} = \"{own}\" ({what})"));
        }
    }
    if base.sensor.driver == SensorDriver::Topic {
        unused.push("sensor.driver = \"topic\" (a Net F/T box is simulated here)".to_owned());
        set(cell, "sensor.driver", "netft")?;
        remove(cell, "sensor.topic");
    }
    // The simulated sensor and camera publish on these keys.
    for input in ["wrench", "image", "camera_info"] {
        let key = format!("ros2.inputs.{input}");
        if get(cell, &key).is_some() {
            remove(cell, &key);
            unused.push(format!("{key} (simulated here)"));
        }
    }
    for (key, own, simulated) in ports(base) {
        if own != simulated {
            unused.push(format!("{key} = {own} (simulated at {simulated})"));
            set(cell, key, simulated)?;
        }
    }
    let gravity = "robot.gravity_in_base_m_per_s2";
    if [0.0, 0.0] != base.robot.gravity_in_base_m_per_s2[..2]
        || base.robot.gravity_in_base().z > 0.0
    {
        unused.push(format!("{gravity} (the simulated arm stands on the floor)"));
        remove(cell, gravity);
    }
    if let Some(file) = &base.robot.calibration_file {
        unused.push(format!(
            "robot.calibration_file = \"{}\" (the simulated arm is that of the table)",
            file.display()
        ));
        remove(cell, "robot.calibration_file");
    }
    camera(cell, base, played, &mut unused)?;
    if !base.recorder.cells.is_empty() {
        remove(cell, "recorder.cells");
        unused.push("recorder.cells (this cell alone is recorded)".to_owned());
    }
    Ok(unused)
}

/// The images are those of the scenario's camera, so its calibration replaces that of the file.
fn camera(
    cell: &mut Table,
    base: &CellConfig,
    played: &Scenario,
    unused: &mut Vec<String>,
) -> Result<(), SimulatedCellError> {
    let Some(own) = &base.camera else {
        return Ok(());
    };
    let before = cell.clone();
    match played {
        Scenario::Admittance(scenario) => {
            let Some(camera) = &scenario.plant.depth_camera else {
                cell.remove("camera");
                unused.push("[camera] (this scenario has none)".to_owned());
                return Ok(());
            };
            scenario_cell::camera_with_depth(cell, camera)?;
        }
        Scenario::ObjectPose(scenario) => scenario_cell::target_camera(cell, scenario)?,
        Scenario::VisuoTactile(scenario) => scenario_cell::depth_camera(cell, scenario)?,
    }
    // How many images viewers get and how the fits are set stays the cell's.
    set(cell, "camera.pass_on_hz", own.pass_on_hz)?;
    if let Some(settings) = get(&before, "estimators.settings").cloned() {
        set(cell, "estimators.settings", settings)?;
    }
    let simulated = base.changed("the simulated camera", |table| {
        if let Some(camera) = cell.get("camera") {
            table.insert("camera".to_owned(), camera.clone());
        }
    });
    let simulated = simulated.map_err(SimulatedCellError::Cell)?.camera;
    if let Some(simulated) = simulated {
        let near = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        let (mine, theirs) = (&own.flange_from_camera, &simulated.flange_from_camera);
        let same = own.topic == simulated.topic
            && own.recording.is_none()
            && own.info_topic.is_none()
            && own.calibration() == simulated.calibration()
            && near(&mine.translation_m, &theirs.translation_m)
            && near(&mine.rotation_vector_rad, &theirs.rotation_vector_rad);
        if !same {
            unused.push("[camera]: topic, calibration and mounting (the images are those of the scenario's camera)".to_owned());
        }
    }
    Ok(())
}
