//! `tangent calibrate payload`: what hangs on the sensor, from readings in several orientations of
//! the arm.

use std::io::BufRead;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use tangent_mechanics::{Base, Flange, Pose, Sensor, Tool, Wrench};
use tangent_recorder::Recording;
use tangent_runtime::{Bus, CellConfig};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, WrenchStatus};
use tangent_schemas::{Message, cdr, topics};
use tangent_sensing::{
    IdentifiedPayload, PoseAverage, PoseFinder, StaticPose, TareConfig, Validity, identify_payload,
};

use crate::cell;
use crate::cli::CalibratePayload;
use crate::output::{Outcome, bad_usage, print_json};

/// Time averaged per pose, s.
const AVERAGE_S: f64 = 1.0;
/// How long a pose's readings are waited for beyond that.
const SLACK: Duration = Duration::from_secs(3);
/// An arm state older than this says nothing about the pose.
const FRESH: Duration = Duration::from_millis(200);
/// Rotation between the sensor as found and as in the cell file that is worth a warning, rad.
const MOUNTING_OFF_RAD: f64 = 0.035;
/// Spread of the fit's singular values that is worth a warning.
const ANISOTROPY_MAX: f64 = 0.05;

/// Identifies the payload, live or from a recording.
///
/// # Errors
/// A cell or file that gives no readings, or poses that say nothing.
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
        eprintln!("warning: {warning}");
    }
    Ok(Outcome::Done)
}

fn tare_config() -> TareConfig {
    TareConfig {
        duration_s: AVERAGE_S,
        ..TareConfig::default()
    }
}

fn live(wanted: usize, config: &CellConfig) -> Result<Vec<StaticPose>> {
    let bus = cell::join(config)?;
    eprintln!(
        "{wanted} poses: turn the tool up, down and to all sides, nothing touching it; come back to the first at the end"
    );
    let mut poses = Vec::new();
    let mut lines = std::io::stdin().lock().lines();
    while poses.len() < wanted {
        eprintln!(
            "pose {} of {wanted}: hold still, then press Enter",
            poses.len() + 1
        );
        if lines.next().transpose()?.is_none() {
            bail!(
                "the input ended after {} of {wanted} poses; press Enter at each, or read them from a recording with --from",
                poses.len()
            );
        }
        match pose(&bus, config) {
            Ok(pose) => poses.push(pose),
            Err(error) => eprintln!("not taken: {error:#}"),
        }
    }
    Ok(poses)
}

/// One pose, averaged from now on.
fn pose(bus: &Bus, config: &CellConfig) -> Result<StaticPose> {
    let flange_from_tool = config.tool.flange_from_tool();
    let mut arm = bus.latest(&topics::ARM_STATE)?;
    let mut status = bus.latest(&topics::WRENCH_STATUS)?;
    let readings = bus.subscribe(&topics::WRENCH_RAW, 16_384)?;
    let mut average = PoseAverage::new(&tare_config(), raw_rate_hz(config));
    let until = Instant::now() + Duration::from_secs_f64(AVERAGE_S) + SLACK;
    let mut taken = 0;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        let Some(reading) = readings.recv_timeout(left.min(FRESH)) else {
            continue;
        };
        let Some(state) = arm.fresh(FRESH) else {
            // The first is on its way; its lasting absence ends below.
            continue;
        };
        let base_from_tool = tool_pose(&state.message)?;
        let sound: Option<&WrenchStatus> = status.get().map(|r| &r.message);
        if let Some(status) = sound {
            usable(status)?;
        }
        taken += 1;
        let wrench = Wrench::<Sensor>::from(&reading.message.wrench);
        if let Some(done) = average.take(&wrench, &base_from_tool, &flange_from_tool) {
            return Ok(done?);
        }
    }
    if taken == 0 {
        bail!(
            "no readings of a standing arm: are netft and rtde running? `tangent status` shows them"
        );
    }
    bail!(
        "only {taken} readings in {:?}: [sensor] rate_hz and raw_rate_hz say {} per second",
        Duration::from_secs_f64(AVERAGE_S) + SLACK,
        raw_rate_hz(config)
    )
}

/// Readings on `wrench/raw` per second, as configured.
fn raw_rate_hz(config: &CellConfig) -> f64 {
    let sensor = &config.sensor;
    if sensor.raw_rate_hz > 0.0 {
        sensor.raw_rate_hz.min(sensor.rate_hz)
    } else {
        sensor.rate_hz
    }
}

fn tool_pose(state: &ArmState) -> Result<Pose<Base, Tool>> {
    Pose::try_from(&state.tool_pose).context("arm/state has no usable pose")
}

/// A reading may be taken: the sensor itself is well, whatever its payload and zero.
fn usable(status: &WrenchStatus) -> Result<()> {
    let validity = Validity::from(status.validity);
    let sick = matches!(
        validity,
        Validity::Saturated | Validity::NotFinite | Validity::SensorError
    );
    if sick || validity.is_judged_over_time() {
        bail!("the sensor: {} ({})", validity.reason(), status.status_text);
    }
    Ok(())
}

/// Every stand of the arm in a recording.
fn recorded(file: &Path, config: &CellConfig) -> Result<Vec<StaticPose>> {
    let recording = Recording::open(file).map_err(bad_usage)?;
    let flange_from_tool: Pose<Flange, Tool> = config.tool.flange_from_tool();
    let mut finder = PoseFinder::new(&tare_config(), rate_hz(&recording));
    let mut pose: Option<(u64, Pose<Base, Tool>)> = None;
    let mut sound = true;
    let mut messages = 0u64;
    for message in recording.messages() {
        match message.topic.as_str() {
            topic if topic == slashed(topics::ARM_STATE.key()) => {
                let state: ArmState = cdr::decode(&message.bytes)?;
                pose = tool_pose(&state).ok().map(|p| (message.log_time_ns, p));
            }
            topic if topic == slashed(topics::WRENCH_STATUS.key()) => {
                sound = usable(&cdr::decode(&message.bytes)?).is_ok();
            }
            topic if topic == slashed(topics::WRENCH_RAW.key()) => {
                messages += 1;
                let Some((at_ns, pose)) = &pose else { continue };
                let old = message.log_time_ns.saturating_sub(*at_ns) > FRESH.as_nanos() as u64;
                if sound && !old {
                    let reading: WrenchStamped = cdr::decode(&message.bytes)?;
                    finder.take(&Wrench::from(&reading.wrench), pose, &flange_from_tool);
                }
            }
            _ => {}
        }
    }
    if messages == 0 {
        bail!(
            "{} holds no /{} ({}): record with netft and rtde running",
            file.display(),
            topics::WRENCH_RAW.key(),
            WrenchStamped::NAME
        );
    }
    Ok(finder.found().to_vec())
}

fn slashed(key: &str) -> String {
    format!("/{key}")
}

/// Readings per second, as recorded.
fn rate_hz(recording: &Recording) -> f64 {
    let topic = slashed(topics::WRENCH_RAW.key());
    let mut times = recording
        .messages()
        .filter(|m| m.topic == topic)
        .map(|m| m.publish_time_ns);
    let Some(first) = times.next() else {
        return 1.0;
    };
    let (mut count, mut last) = (0.0, first);
    for time in times {
        count += 1.0;
        last = last.max(time);
    }
    count / ((last - first) as f64 * 1e-9).max(1e-3)
}

fn warnings(found: &IdentifiedPayload, config: &CellConfig) -> Vec<String> {
    let mut all = Vec::new();
    let off = mounting_error_rad(found, config);
    if off > MOUNTING_OFF_RAD {
        let vector = found.flange_from_sensor.scaled_axis();
        all.push(format!(
            "the sensor is turned by {:.1} deg against [sensor.flange_from_sensor] rotation_vector_rad; the readings say \
             [{:.4}, {:.4}, {:.4}]",
            off.to_degrees(),
            vector.x,
            vector.y,
            vector.z
        ));
    }
    if found.anisotropy > ANISOTROPY_MAX {
        all.push(format!(
            "the sensor weighs the payload {:.0} % differently along its axes: wrong calibration loaded, or something \
             touched the tool",
            100.0 * found.anisotropy
        ));
    }
    if found.drift.is_none() {
        all.push("the last pose is not the first again: the drift meanwhile is unknown".to_owned());
    }
    all
}

fn mounting_error_rad(found: &IdentifiedPayload, config: &CellConfig) -> f64 {
    found
        .flange_from_sensor
        .angle_to(&config.sensor.flange_from_sensor().rotation())
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

/// JSON has no infinity.
fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}

fn print(found: &IdentifiedPayload, poses: usize, config: &CellConfig) {
    let [x, y, z] = found.payload.com_in_sensor_m;
    let worst = found.com_sd_m.into_iter().fold(0.0, f64::max);
    println!("# {poses} poses. For the cell file:");
    println!("[tool]");
    println!(
        "mass_kg = {:.4}    # ± {:.4}; the cell file has {}",
        found.payload.mass_kg, found.mass_sd_kg, config.tool.mass_kg
    );
    println!(
        "com_in_sensor_m = [{x:.4}, {y:.4}, {z:.4}]    # ± {worst:.4}; the cell file has {:?}",
        config.tool.com_in_sensor_m
    );
    println!(
        "# each pose predicted from the others: {:.3} N, {:.4} Nm rms",
        found.left_out_force_rms_n, found.left_out_torque_rms_nm
    );
    let (f, t) = (&found.bias.force, &found.bias.torque);
    println!(
        "# zero of the sensor: [{:.2}, {:.2}, {:.2}] N, [{:.3}, {:.3}, {:.3}] Nm",
        f.x, f.y, f.z, t.x, t.y, t.z
    );
    if let Some(drift) = &found.drift {
        println!(
            "# drift from the first to the last: {:.3} N, {:.4} Nm",
            drift.force.norm(),
            drift.torque.norm()
        );
    }
}
