//! `tangent calibrate payload`: identifies the payload on the sensor from readings in several
//! orientations of the arm.

use std::io::BufRead;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use tangent_calibrate::{mounting_error_rad, pose, recorded, warnings};
use tangent_client::session;
use tangent_mechanics::{Sensor, Wrench};
use tangent_runtime::CellConfig;
use tangent_sensing::{IdentifiedPayload, StaticPose, identify_payload};

use crate::cli::CalibratePayload;
use crate::output::{Outcome, print_json};
use crate::terminal;

/// Identifies the payload from a live cell or from a recording.
///
/// # Errors
/// The cell or file gives no readings, or the poses do not determine the payload.
pub fn payload(args: &CalibratePayload, config: &CellConfig, json: bool) -> Result<Outcome> {
    let poses = match &args.from {
        Some(file) => recorded(file, config)?,
        None => live(usize::from(args.poses), config)?,
    };
    let found = identify_payload(&poses, &config.robot.gravity_in_base())
        .with_context(|| format!("{} poses", poses.len()))?;
    let figures = figures(&found, poses.len(), config);
    if json {
        print_json(&figures)?;
    } else {
        print(&found, poses.len(), config);
    }
    for warning in warnings(&found, config) {
        terminal::say(&format!("warning: {warning}"));
    }
    Ok(Outcome::Done)
}

fn live(wanted: usize, config: &CellConfig) -> Result<Vec<StaticPose>> {
    let bus = session::join(config)?;
    terminal::say(&format!(
        "{wanted} poses: turn the tool up, down and to all sides, with nothing touching it; end with the first pose again"
    ));
    let mut poses = Vec::new();
    let mut lines = std::io::stdin().lock().lines();
    while poses.len() < wanted {
        terminal::say(&format!(
            "pose {} of {wanted}: hold still, then press Enter",
            poses.len() + 1
        ));
        if lines.next().transpose()?.is_none() {
            bail!(
                "the input ended after {} of {wanted} poses; press Enter at each, or read them from a recording with --from",
                poses.len()
            );
        }
        match pose(&bus, config) {
            Ok(pose) => poses.push(pose),
            Err(error) => terminal::say(&format!("not taken: {:#}", anyhow::Error::from(error))),
        }
    }
    Ok(poses)
}

fn figures(found: &IdentifiedPayload, poses: usize, config: &CellConfig) -> Value {
    let wrench = |w: &Wrench<Sensor>| -> Vec<f64> { w.vector().iter().copied().collect() };
    json!({
        "poses": poses,
        "mass_kg": found.payload.mass_kg,
        "mass_sd_kg": finite(found.mass_sd_kg),
        "com_in_sensor_m": found.payload.com_in_sensor_m,
        "com_sd_m": found.com_sd_m.map(finite),
        "bias": wrench(&found.bias),
        "residual_force_rms_n": finite(found.left_out_force_rms_n),
        "residual_torque_rms_nm": finite(found.left_out_torque_rms_nm),
        "flange_from_sensor_rotation_vector_rad":
            found.flange_from_sensor.scaled_axis().as_slice(),
        "mounting_error_deg": mounting_error_rad(found, config).to_degrees(),
        "anisotropy": found.anisotropy,
        "drift": found.drift.as_ref().map(wrench),
        "warnings": warnings(found, config),
    })
}

/// JSON cannot represent infinity.
fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}

fn print(found: &IdentifiedPayload, poses: usize, config: &CellConfig) {
    print!("{}", cell_file(found, poses, config));
}

/// Lines for the cell file, with the rest of the result as comments.
pub fn cell_file(found: &IdentifiedPayload, poses: usize, config: &CellConfig) -> String {
    let [x, y, z] = found.payload.com_in_sensor_m;
    let worst = found.com_sd_m.into_iter().fold(0.0, f64::max);
    let [own_x, own_y, own_z] = config.tool.com_in_sensor_m;
    let (f, t) = (&found.bias.force, &found.bias.torque);
    let mut lines = vec![
        format!("# {poses} poses. For the cell file:"),
        "[tool]".to_owned(),
        format!(
            "mass_kg = {:.4}    # ± {:.4}; the cell file has {}",
            found.payload.mass_kg, found.mass_sd_kg, config.tool.mass_kg
        ),
        format!(
            "com_in_sensor_m = [{x:.4}, {y:.4}, {z:.4}]    # ± {worst:.4}; the cell file has [{own_x}, {own_y}, {own_z}]"
        ),
        format!(
            "# each pose predicted from the others: {:.3} N, {:.4} Nm rms",
            found.left_out_force_rms_n, found.left_out_torque_rms_nm
        ),
        format!(
            "# zero of the sensor: [{:.2}, {:.2}, {:.2}] N, [{:.3}, {:.3}, {:.3}] Nm",
            f.x, f.y, f.z, t.x, t.y, t.z
        ),
    ];
    if let Some(drift) = &found.drift {
        lines.push(format!(
            "# drift from the first to the last: {:.3} N, {:.4} Nm",
            drift.force.norm(),
            drift.torque.norm()
        ));
    }
    lines.join("\n") + "\n"
}
