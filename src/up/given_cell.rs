//! `tangent up --cell FILE`: runs the cell of the file against the simulator. What a simulator
//! cannot stand for is named.

use anyhow::Result;
use tangent_runtime::CellConfig;
use tangent_runtime::config::{Law, RobotDriver};
use toml::{Table, Value};

use super::cell_keys::{get, remove, set};
use super::simulated_cell;
use crate::output::bad_usage;
use crate::scenarios::{self, Played};
use crate::simulated_plant;

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

/// The scenario that fits a cell whose user names none: the one that the file names, or that of the
/// system with this law.
pub fn scenario(cell: &CellConfig) -> String {
    if let Some(own) = &cell.simulator.scenario {
        return own.display().to_string();
    }
    let system = match cell.controller.law {
        Law::HybridAdmittance => "tugal",
        Law::HybridDynamics => "lippiello",
        Law::UnifiedForceImpedance => "karacan",
    };
    scenarios::of_system(system)
        .unwrap_or(scenarios::DEFAULT)
        .to_owned()
}

/// Fits the scenario to the cell: its arm, at its control rate, with its tool.
///
/// # Errors
/// A cell that this scenario cannot be played with, or an arm of the user's own, which no simulator
/// knows.
pub fn fit(cell: &CellConfig, played: &mut Played) -> Result<()> {
    let (law, driver) = match played {
        Played::Normals(_) => (Law::HybridAdmittance, RobotDriver::Rtde),
        Played::Object(_) => (Law::HybridDynamics, RobotDriver::Rtde),
        Played::Tactile(_) => (Law::UnifiedForceImpedance, RobotDriver::Franka),
    };
    if cell.controller.law != law || cell.robot.driver != driver {
        return Err(bad_usage(format!(
            "cell {}: [controller] law = {:?} and [robot] driver = {:?} do not fit the scenario {}, which is for law {law:?} and driver {driver:?}: name another with --scenario, or leave it out and the cell's own is played",
            cell.cell.name,
            cell.controller.law,
            cell.robot.driver,
            played.name()
        )));
    }
    if let Some(file) = &cell.robot.model_file {
        return Err(bad_usage(format!(
            "cell {}: robot.model_file = {}: only built-in arms can be simulated; name one of them as robot.model, or run the cell's services with `tangent run` against the real arm",
            cell.cell.name,
            file.display()
        )));
    }
    simulated_plant::take_arm(played, cell);
    simulated_plant::take_tool(played, cell);
    Ok(())
}

/// Writes into `cell` what is simulated in place of what the file says; returns each such key with
/// what became of it.
///
/// # Errors
/// A value that cannot be written.
pub fn write(cell: &mut Table, base: &CellConfig, played: &Played) -> Result<Vec<String>> {
    let mut unused = Vec::new();
    for (key, what) in [
        ("robot.address", "the arm is simulated here"),
        ("sensor.address", "the sensor is simulated here"),
    ] {
        let own = get(cell, key).and_then(Value::as_str).unwrap_or_default();
        // A Franka has no box: its file says so.
        if own != HERE && own != "none" {
            unused.push(format!("{key} = \"{own}\" ({what})"));
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
    camera(cell, base, played, &mut unused)?;
    if !base.recorder.cells.is_empty() {
        remove(cell, "recorder.cells");
        unused.push("recorder.cells (this cell alone is recorded)".to_owned());
    }
    Ok(unused)
}

/// The images are those of the scenario's camera, so what is known of the camera is what is known
/// of that one.
fn camera(
    cell: &mut Table,
    base: &CellConfig,
    played: &Played,
    unused: &mut Vec<String>,
) -> Result<()> {
    let Some(own) = &base.camera else {
        return Ok(());
    };
    let before = cell.clone();
    match played {
        Played::Normals(_) => {
            cell.remove("camera");
            unused.push("[camera] (this scenario has none)".to_owned());
            return Ok(());
        }
        Played::Object(scenario) => simulated_cell::target_camera(cell, scenario)?,
        Played::Tactile(scenario) => simulated_cell::depth_camera(cell, scenario)?,
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
    let simulated = simulated.map_err(bad_usage)?.camera;
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
