//! Readings of one pose of a running cell.

use std::time::{Duration, Instant};

use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};
use tangent_runtime::bus::Subscription;
use tangent_runtime::{Bus, CellConfig};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, WrenchStatus};
use tangent_schemas::topics;
use tangent_sensing::{PoseAverage, StaticPose, TareConfig, Validity};

use crate::error::CalibrateError;

/// Time averaged per pose, s.
const AVERAGE_S: f64 = 1.0;
/// Additional time allowed for the readings of a pose.
const SLACK: Duration = Duration::from_secs(3);
/// Time over which the rate of readings is measured if the cell file does not state it.
const RATE_TIME: Duration = Duration::from_millis(300);
/// Largest age at which an arm state still gives the present pose.
pub(crate) const FRESH: Duration = Duration::from_millis(200);

/// Settings of the average over a pose.
pub(crate) fn tare_config() -> TareConfig {
    TareConfig {
        duration_s: AVERAGE_S,
        ..TareConfig::default()
    }
}

/// Averages one pose of a running cell over the next second.
///
/// # Errors
/// The arm moves, the sensor reports a problem, or there are too few readings.
pub fn pose(bus: &Bus, config: &CellConfig) -> Result<StaticPose, CalibrateError> {
    let flange_from_tool = config.tool.flange_from_tool();
    let mut arm = bus.latest(&topics::ARM_STATE)?;
    let mut status = bus.latest(&topics::WRENCH_STATUS)?;
    let readings = bus.subscribe(&topics::WRENCH_RAW, 16_384)?;
    let wanted_hz = match raw_rate_hz(config) {
        Some(stated) => stated,
        None => measured_hz(&readings)?,
    };
    let mut average = PoseAverage::new(&tare_config(), wanted_hz);
    let until = Instant::now() + Duration::from_secs_f64(AVERAGE_S) + SLACK;
    let mut taken = 0;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        let Some(reading) = readings.recv_timeout(left.min(FRESH)) else {
            continue;
        };
        let Some(state) = arm.fresh(FRESH) else {
            // The first message may still be on its way. If none comes, the deadline below ends the
            // loop.
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
        return Err(CalibrateError::NoReadings);
    }
    Err(CalibrateError::TooFewReadings {
        taken,
        within: Duration::from_secs_f64(AVERAGE_S) + SLACK,
        wanted_hz,
    })
}

/// Rate of readings on `wrench/raw`, Hz, if it follows from the cell file. Otherwise, it is that of
/// the box's own setting.
fn raw_rate_hz(config: &CellConfig) -> Option<f64> {
    let sensor = &config.sensor;
    match (sensor.rate_stated_hz(), sensor.raw_rate_hz) {
        (Some(records), raw) if raw > 0.0 => Some(raw.min(records)),
        (Some(records), _) => Some(records),
        (None, _) => None,
    }
}

/// Rate at which readings arrive, Hz.
fn measured_hz(readings: &Subscription<WrenchStamped>) -> Result<f64, CalibrateError> {
    let mut began = None;
    let mut count = 0;
    let until = Instant::now() + SLACK;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        let Some(reading) = readings.recv_timeout(left) else {
            continue;
        };
        let first = *began.get_or_insert(reading.received);
        let passed = reading.received.saturating_duration_since(first);
        if passed >= RATE_TIME {
            return Ok(f64::from(count) / passed.as_secs_f64());
        }
        count += 1;
    }
    Err(CalibrateError::NoReadings)
}

pub(crate) fn tool_pose(state: &ArmState) -> Result<Pose<Base, Tool>, CalibrateError> {
    Pose::try_from(&state.tool_pose).map_err(CalibrateError::NoPose)
}

/// Checks that the sensor itself works, whatever its payload and zero.
pub(crate) fn usable(status: &WrenchStatus) -> Result<(), CalibrateError> {
    let validity = Validity::from(status.validity);
    let sick = matches!(
        validity,
        Validity::Saturated | Validity::NotFinite | Validity::SensorError
    );
    if sick || validity.is_judged_over_time() {
        return Err(CalibrateError::Sensor {
            reason: validity.reason(),
            status: status.status_text.to_string(),
        });
    }
    Ok(())
}
