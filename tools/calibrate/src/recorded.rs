//! Poses of the arm in a recording.

use std::path::Path;

use tangent_mechanics::{Base, Flange, Pose, Tool, Wrench};
use tangent_recorder::Recording;
use tangent_runtime::CellConfig;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{cdr, topics};
use tangent_sensing::{PoseFinder, StaticPose};

use crate::error::CalibrateError;
use crate::live::{FRESH, tare_config, tool_pose, usable};

/// Finds every pose in a recording at which the arm stands still.
///
/// # Errors
/// The file cannot be read, or has no readings.
pub fn recorded(file: &Path, config: &CellConfig) -> Result<Vec<StaticPose>, CalibrateError> {
    let recording = Recording::open(file).map_err(CalibrateError::Recording)?;
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
        return Err(CalibrateError::NothingRecorded(file.to_owned()));
    }
    Ok(finder.found().to_vec())
}

fn slashed(key: &str) -> String {
    format!("/{key}")
}

/// Recorded rate of readings, Hz.
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
