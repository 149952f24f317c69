//! Checks a cell file with the rules of every service of the cell.

use std::path::Path;

use nalgebra::Vector3;
use tangent_compose::with_causes;
use tangent_estimation::{build, build_object_estimator};
use tangent_mechanics::Tip;
use tangent_runtime::config::{Law, RobotDriver};
use tangent_runtime::{Bus, CellConfig};
use tangent_simulated_cell::scenarios;

use crate::findings::Findings;

/// Shortest tool, m, whose direction is judged, and the cosine of its angle to the frame's z axis
/// below which that axis leads back.
const OFFSET_LEAST_M: f64 = 0.01;
const BACKWARDS_COS: f64 = -0.5;

pub fn check(path: &Path, findings: &mut Findings) {
    let config = match CellConfig::load(path) {
        Ok(config) => config,
        Err(error) => return findings.error(error),
    };
    services(&config, findings);
    if let Err(error) = Bus::check_listeners(&config.zenoh) {
        findings.error(error);
    }
    if let Some(scenario) = &config.simulator.scenario
        && let Err(error) = scenarios::load(&scenario.display().to_string(), &[])
    {
        let error = with_causes(&error);
        findings.error(format!("simulator.scenario: {error}"));
    }
    findings.extend_notes(tip(&config));
    findings.extend_notes(backwards(&config));
    for (key, file) in files(&config) {
        if !file.exists() {
            findings.note(format!("{key}: {} does not exist yet", file.display()));
        }
    }
    let (force, range) = (config.limits.force_max_n, config.sensor.force_range_n[2]);
    if config.robot.driver == RobotDriver::Rtde && force > range {
        findings.note(format!(
            "limits.force_max_n = {force} N is above the sensor's range along z, sensor.force_range_n = {range} N: the \
             sensor saturates first, which causes a retraction"
        ));
    }
}

/// A tool frame whose z axis leads back to the flange; `None` for one that leads away from it. On a
/// hook, both are right.
fn backwards(config: &CellConfig) -> Option<String> {
    let flange_from_tool = config.tool.flange_from_tool();
    let from_flange = flange_from_tool
        .translation()
        .try_normalize(OFFSET_LEAST_M)?;
    let along = flange_from_tool.rotate(&Vector3::z()).dot(&from_flange);
    (along < BACKWARDS_COS).then(|| {
        "tool.flange_from_tool: z of the tool points back to the flange, and it must point out of the tool, into the \
         surface. If the surface is not on the flange's side of the tip, turn the frame: rotation_vector_rad = [0, 0, 0] \
         where both z axes agree"
            .to_owned()
    })
}

/// What each estimator of normals is told of the tool's tip; `None` without such estimators.
fn tip(config: &CellConfig) -> Option<String> {
    let model = tangent_compose::model(config).ok()?;
    let estimator = tangent_estimator::Config::from_cell(config, model).ok()?;
    let stated = config.tool.tip.tip();
    let (told, own): (Vec<_>, Vec<_>) = estimator
        .estimators
        .iter()
        .partition(|choice| choice.settings.contact.tip == stated);
    let names: Vec<&str> = told.iter().map(|choice| choice.name.as_str()).collect();
    let mut said = Vec::new();
    if !names.is_empty() {
        said.push(format!("{} for {}", shape(&stated), names.join(", ")));
    }
    said.extend(own.iter().map(|choice| {
        let tip = shape(&choice.settings.contact.tip);
        format!("{tip} for {} ([estimators.settings])", choice.name)
    }));
    if said.is_empty() {
        return None;
    }
    let advice = if stated == Tip::Unknown {
        "; nothing is concluded from the torque of an unknown tip: state kind (flat, ring, round, soft) and radius_m in [tool.tip] \
         if they are known"
    } else {
        ""
    };
    Some(format!("tool.tip: {}{advice}", said.join("; ")))
}

fn shape(tip: &Tip) -> String {
    match tip.radius_m() {
        Some(radius_m) => format!("{}, radius {} mm,", tip.name(), shown_mm(radius_m)),
        None => tip.name().to_owned(),
    }
}

/// Millimetres without the digits of rounding: 8, not 8.000000000000001.
fn shown_mm(metres: f64) -> f64 {
    (metres * 1e6).round() / 1e3
}

/// Runs the configuration checks of each service that this cell needs.
pub fn services(config: &CellConfig, findings: &mut Findings) {
    let model = match tangent_compose::model(config) {
        Ok(model) => model,
        Err(error) => return findings.error(with_causes(&error)),
    };
    let torque = config.controller.law != Law::HybridAdmittance;
    if config.robot.driver == RobotDriver::Franka {
        if let Err(error) = tangent_franka::Config::from_cell(config) {
            findings.error(error);
        }
    } else if !torque && let Err(error) = tangent_rtde::Config::from_cell(config) {
        findings.error(error);
    }
    let controller = if torque {
        tangent_controller::TorqueConfig::from_cell(config, &model).map(drop)
    } else {
        tangent_controller::Config::from_cell(config, model.clone()).map(drop)
    };
    if let Err(error) = controller {
        findings.error(error);
    }
    if config.camera.is_some()
        && let Err(error) = tangent_camera::Config::from_cell(config)
    {
        findings.error(error);
    }
    let estimator = match tangent_estimator::Config::from_cell(config, model) {
        Ok(estimator) => estimator,
        Err(error) => return findings.error(error),
    };
    for choice in &estimator.estimators {
        if let Err(error) = build(&choice.name, &choice.settings) {
            findings.error(format!("estimators.run: {error}"));
        }
    }
    for choice in &estimator.objects {
        match &estimator.camera {
            None => findings.error(format!(
                "estimators.run: \"{}\" needs a camera, and there is no [camera] with a calibration",
                choice.name
            )),
            Some(camera) => {
                if let Err(error) = build_object_estimator(&choice.name, &choice.settings, camera) {
                    findings.error(format!("estimators.run: {error}"));
                }
            }
        }
    }
    for (index, name) in config.estimators.run.iter().enumerate() {
        if config.estimators.run[..index].contains(name) {
            findings.error(format!("estimators.run: \"{name}\" is listed twice"));
        }
    }
    let known = tangent_controller::known_estimators(&config.estimators.run);
    let active = config.estimators.active.as_str();
    if !known.contains(&active)
        && let Some(unknown) = tangent_controller::unknown_estimators(&[active], &known)
    {
        findings.note(format!("estimators.active: {unknown}"));
    } else if !config.estimators.run.iter().any(|name| name == active) {
        findings.note(format!(
            "estimators.active = \"{active}\" is not in estimators.run: another process must publish it when a task is \
             started"
        ));
    }
}

/// Files that the cell names and that its services open.
fn files(config: &CellConfig) -> Vec<(&'static str, &Path)> {
    let mut files = Vec::new();
    files.extend(
        config
            .zenoh
            .file
            .as_deref()
            .map(|file| ("zenoh.file", file)),
    );
    files.extend(
        config
            .zenoh
            .access
            .as_deref()
            .map(|file| ("zenoh.access", file)),
    );
    if let Some(tls) = &config.zenoh.tls {
        files.push(("zenoh.tls.ca", tls.ca.as_path()));
    }
    let camera = config.camera.as_ref();
    let recording = camera.and_then(|camera| camera.recording.as_deref());
    files.extend(recording.map(|file| ("camera.recording", file)));
    files
}
