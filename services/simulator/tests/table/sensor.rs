//! The records of a force sensor passed through watch and conditioning, as in the sensor's service.

use nalgebra::Vector6;
use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};
use tangent_sensing::{
    ConditionedWrench, ConditioningConfig, Payload, Reading, RecordWatchConfig, SensorCondition,
    SensorRecord, SensorWatch, SensorWatchState, Watched, WrenchConditioner,
    WrenchConditionerState, pressing_at,
};
use tangent_simulation::{PayloadConfig, SensorConfig, SensorSample};

/// Faults of a record besides its counts.
#[derive(Clone, Copy, Debug)]
pub struct RecordFaults {
    /// The record is not a number.
    pub nan: bool,
    /// The sensor reports an error.
    pub error: bool,
    /// A gauge is saturated.
    pub saturated: bool,
    /// The measured contact force is zero after conditioning.
    pub contact_lost: bool,
}

/// Watch and conditioning of a sensor, with their state.
pub struct SensorChain {
    pub conditioner: WrenchConditioner,
    pub conditioning: WrenchConditionerState,
    watch: SensorWatch,
    pub watching: SensorWatchState,
    /// The newest wrench, and the time of measurement of its record, s.
    pub wrench: Option<(ConditionedWrench, f64)>,
    scale: [f64; 6],
}

impl SensorChain {
    /// Creates the chain of a sensor under a tool with this payload.
    pub fn new(
        sensing: &ConditioningConfig,
        payload: &PayloadConfig,
        sensor_from_tool: Pose<Sensor, Tool>,
        sensor: &SensorConfig,
    ) -> Self {
        let payload = Payload {
            mass_kg: payload.mass_kg,
            com_in_sensor_m: payload.com_in_sensor_m,
            inertia_kg_m2: payload.inertia_kg_m2,
        };
        let rate_hz = sensor.rate_hz;
        let ([fx, fy, fz], [tx, ty, tz]) = (sensor.range_n, sensor.range_nm);
        let range = [fx, fy, fz, tx, ty, tz];
        let (n, nm) = (1.0 / sensor.counts_per_n, 1.0 / sensor.counts_per_nm);
        Self {
            conditioner: WrenchConditioner::new(sensing, &payload, sensor_from_tool, rate_hz)
                .unwrap(),
            conditioning: WrenchConditionerState::default(),
            watch: SensorWatch::new(
                &RecordWatchConfig::default(),
                rate_hz,
                range,
                sensor_from_tool.translation(),
            ),
            watching: SensorWatchState::default(),
            wrench: None,
            scale: [n, n, n, nm, nm, nm],
        }
    }

    /// Converts a load (N or Nm) along one axis to counts.
    pub fn counts_of(&self, axis: usize, load: f64) -> i32 {
        (load / self.scale[axis]) as i32
    }

    /// The sensor's service restarts. It keeps the last good zero.
    pub fn restart(&mut self) {
        let zero = self.conditioning.reference().copied();
        self.conditioning = WrenchConditionerState::default();
        self.conditioning.set_tare(zero);
    }

    /// Processes one record, with its counts after faults. `tool`: its newest pose, and by how much
    /// that is older than the record, s.
    pub fn take(
        &mut self,
        sample: &SensorSample,
        counts: [i32; 6],
        faults: RecordFaults,
        tool: (Pose<Base, Tool>, f64),
    ) {
        let mut raw = Vector6::from_fn(|i, _| f64::from(counts[i]) * self.scale[i]);
        if faults.nan {
            raw.fill(f64::NAN);
        }
        let condition = if faults.error {
            SensorCondition::Error
        } else if sample.saturated || faults.saturated {
            SensorCondition::Saturated
        } else {
            SensorCondition::Good
        };
        let zeroed = self.wrench.filter(|(w, _)| w.bias_age_s.is_some());
        let record = SensorRecord {
            counts,
            wrench: raw.into(),
            condition,
            missed: 0,
            pressing_at: zeroed
                .and_then(|(w, _)| pressing_at(Some(tool.0.translation()), &w.wrench.force)),
            felt_n: zeroed.map(|(w, _)| w.wrench.force.norm()),
        };
        let taken = self.watch.take(&mut self.watching, &record);
        let Watched::Take { condition, missed } = taken else {
            return;
        };
        let mut conditioned = self.conditioner.update(
            &mut self.conditioning,
            &Reading {
                time_s: sample.time_s,
                wrench: Wrench::from_vector(&raw),
                condition,
                missed,
                base_from_tool: Some(tool),
                motion: None,
            },
        );
        if faults.contact_lost {
            conditioned.wrench = Wrench::zero();
        }
        self.wrench = Some((conditioned, sample.time_s));
    }
}
