//! Converts the sensor's samples to the input of the conditioning: N and Nm, checked by the sensor
//! watch.

use nalgebra::{Vector3, Vector6};
use tangent_mechanics::{Sensor as SensorFrame, Wrench};
use tangent_sensing::{
    ConditionedWrench, Reading, RecordWatchConfig, SensorCondition, SensorRecord, SensorWatch,
    SensorWatchState, Watched, pressing_at,
};

use super::force_torque::SensorConfig;
use super::sample::SensorSample;

/// Receiver of a simulated sensor's samples.
#[derive(Clone, Debug)]
pub(crate) struct WatchedSensor {
    watch: SensorWatch,
    state: SensorWatchState,
    /// N and Nm per count.
    scale: Vector6<f64>,
}

impl WatchedSensor {
    /// Receiver for a tool whose tip is at `tip_in_sensor_m` (m), as stated in the cell file.
    pub fn new(config: &SensorConfig, tip_in_sensor_m: Vector3<f64>) -> Self {
        let ([fx, fy, fz], [tx, ty, tz]) = (config.range_n, config.range_nm);
        Self {
            watch: SensorWatch::new(
                &RecordWatchConfig::default(),
                config.rate_hz,
                [fx, fy, fz, tx, ty, tz],
                tip_in_sensor_m,
            ),
            state: SensorWatchState::default(),
            scale: Vector6::from_fn(|i, _| {
                1.0 / if i < 3 {
                    config.counts_per_n
                } else {
                    config.counts_per_nm
                }
            }),
        }
    }

    /// A reading without the arm's pose; `None` for a sample that is left out. `tool` is the last
    /// position of the tool (m), and `felt` the last reading.
    pub fn take(
        &mut self,
        sample: &SensorSample,
        tool: &Vector3<f64>,
        felt: Option<&ConditionedWrench>,
    ) -> Option<Reading> {
        let wrench: Vector6<f64> =
            Vector6::from_fn(|i, _| f64::from(sample.counts[i])).component_mul(&self.scale);
        let said = if sample.saturated {
            SensorCondition::Saturated
        } else {
            SensorCondition::Good
        };
        let record = SensorRecord {
            counts: sample.counts,
            wrench: wrench.into(),
            condition: said,
            missed: 0,
            pressing_at: felt.and_then(|felt| pressing_at(Some(*tool), &felt.wrench.force)),
            felt_n: felt.map(|felt| felt.wrench.force.norm()),
        };
        let watched = self.watch.take(&mut self.state, &record);
        let Watched::Take { condition, missed } = watched else {
            return None;
        };
        Some(Reading {
            time_s: sample.time_s,
            wrench: Wrench::<SensorFrame>::from_vector(&wrench),
            condition,
            missed,
            base_from_tool: None,
            motion: None,
        })
    }
}
