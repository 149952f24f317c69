//! From a sample of any sensor to the wrench at the tool: plausibility checks, tare, payload,
//! filter and mounting. Every driver of this service passes its samples through here.

use std::time::Instant;

use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};
use tangent_runtime::{Bus, Latest, Parameter, Parameters, Ramp};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics;
use tangent_sensing::{
    ConditionedWrench, Reading, RecordWatchConfig, SensingError, SensorCondition, SensorRecord,
    SensorWatch, SensorWatchState, Watched, WrenchConditioner, WrenchConditionerState, pressing_at,
};
use tangent_tare::Taring;

use crate::NetftError;
use crate::config::Config;

/// Rate at which the filter follows a new cut-off, Hz/s.
const CUTOFF_RATE_HZ_PER_S: f64 = 100.0;

/// One sample of a sensor, as its driver provides it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchSample {
    /// Reading in the sensor's resolution, by which a frozen sensor is detected: Fx, Fy, Fz, Tx,
    /// Ty, Tz.
    pub counts: [i32; 6],
    /// What the environment and the payload do to the sensor, sensor axes, N and Nm, before the
    /// tare.
    pub wrench: Wrench<Sensor>,
    /// Condition that the sensor itself reports.
    pub condition: SensorCondition,
    /// Number of samples lost before this one.
    pub missed: u32,
    /// Time of measurement on a clock that only goes forward, s.
    pub time_s: f64,
    /// Time of arrival on the same clock, s.
    pub arrival_s: f64,
}

/// Conditioning of one sensor's samples, with its state.
pub(crate) struct Conditioning {
    arm: Latest<ArmState>,
    pose: Option<(Pose<Base, Tool>, Instant)>,
    watch: SensorWatch,
    watched: SensorWatchState,
    conditioner: WrenchConditioner,
    state: WrenchConditionerState,
    cutoff: Parameter,
    cutoff_ramp: Ramp,
    taring: Taring,
    /// The last conditioned wrench since the rate was adopted.
    last: Option<ConditionedWrench>,
}

impl Conditioning {
    /// Conditioning at the configured rate.
    ///
    /// # Errors
    /// A setting is out of range, or the bus refuses the arm's state.
    pub(crate) fn new(
        config: &Config,
        bus: &Bus,
        parameters: &Parameters,
        taring: Taring,
    ) -> Result<Self, NetftError> {
        let cutoff_hz = config.conditioning.filter_cutoff_hz;
        Ok(Self {
            arm: bus.latest(&topics::ARM_STATE)?,
            pose: None,
            watch: watch_of(config, config.rate_hz),
            watched: SensorWatchState::default(),
            conditioner: conditioner_of(config, config.rate_hz)?,
            state: WrenchConditionerState::default(),
            cutoff: parameters.number(
                "filter_cutoff_hz",
                cutoff_hz,
                1.0..=0.45 * config.rate_hz,
                "Hz",
                "Cut-off of the low-pass on the wrench; approached at 100 Hz per second.",
            ),
            cutoff_ramp: Ramp::new(cutoff_hz, CUTOFF_RATE_HZ_PER_S),
            taring,
            last: None,
        })
    }

    /// Begins a new stream of samples, and adapts the filter if it has another rate than before.
    ///
    /// # Errors
    /// The filter is not possible at this rate.
    pub(crate) fn adopt_rate(&mut self, config: &Config, rate_hz: f64) -> Result<(), NetftError> {
        if (rate_hz - self.conditioner.filter().sample_rate_hz()).abs() > 1e-9 {
            self.conditioner = conditioner_of(config, rate_hz)?;
            self.cutoff_ramp =
                Ramp::new(self.conditioner.filter().cutoff_hz(), CUTOFF_RATE_HZ_PER_S);
        }
        self.watch = watch_of(config, rate_hz);
        self.last = None;
        self.restart();
        Ok(())
    }

    /// Sets the sensor by its serial number or another identity, see [`Taring::adopt`]. Allocates.
    pub(crate) fn adopt_sensor(&mut self, config: &Config, owner: &str, now_s: f64) {
        let tare = &config.conditioning.tare;
        self.taring.adopt(owner, tare, &mut self.state, now_s);
    }

    /// Empties filter and checks: the next sample does not continue the last one. The zero is kept.
    pub(crate) fn restart(&mut self) {
        self.watched.restart();
        self.state.restart();
    }

    /// Takes in the newest pose of the arm.
    pub(crate) fn refresh_pose(&mut self) {
        if let Some(received) = self.arm.take_new() {
            // An invalid pose counts as none.
            self.pose = Pose::try_from(&received.message.tool_pose)
                .ok()
                .map(|pose| (pose, received.received));
        }
    }

    /// Conditions one sample, and works on a pending tare; `None` if the sample is left out as
    /// damaged. Takes no lock and allocates nothing.
    pub(crate) fn take(
        &mut self,
        config: &Config,
        sample: &WrenchSample,
    ) -> Option<ConditionedWrench> {
        self.taring
            .serve(&self.conditioner, &mut self.state, sample.arrival_s);
        // An untared sensor may show any value without contact.
        let felt = self
            .last
            .filter(|last| last.bias_age_s.is_some())
            .map(|last| last.wrench.force);
        let at = self.pose.map(|(pose, _)| pose.translation());
        let judged = SensorRecord {
            counts: sample.counts,
            wrench: sample.wrench.vector().into(),
            condition: sample.condition,
            missed: sample.missed,
            pressing_at: felt.and_then(|force| pressing_at(at, &force)),
            felt_n: felt.map(|force| force.norm()),
        };
        let Watched::Take { condition, missed } = self.watch.take(&mut self.watched, &judged)
        else {
            return None;
        };
        let reading = Reading {
            time_s: sample.time_s,
            wrench: sample.wrench,
            condition: within_range(condition, &sample.wrench, &config.range),
            missed,
            base_from_tool: self
                .pose
                .map(|(pose, received)| (pose, received.elapsed().as_secs_f64())),
            motion: None,
        };
        let wrench = self.conditioner.update(&mut self.state, &reading);
        self.taring.finish(&mut self.state);
        self.last = Some(wrench);
        Some(wrench)
    }

    /// Approaches a cut-off that was set live at a bounded rate; `dt_s` since the last call.
    pub(crate) fn follow_cutoff(&mut self, rate_hz: f64, dt_s: f64) {
        let max = 0.45 * rate_hz;
        let before = self.cutoff_ramp.value;
        let now = self.cutoff_ramp.step(self.cutoff.get().min(max), dt_s);
        if now != before && self.conditioner.set_filter_cutoff_hz(now).is_err() {
            self.cutoff_ramp.value = before;
        }
    }

    /// Number of samples left out so far.
    pub(crate) fn implausible(&self) -> u64 {
        self.watched.implausible()
    }

    /// Axes whose value stands still: bit 0 is Fx, bit 5 is Tz.
    pub(crate) fn stuck_axes(&self) -> u8 {
        self.watched.stuck_axes()
    }
}

fn conditioner_of(config: &Config, rate_hz: f64) -> Result<WrenchConditioner, SensingError> {
    WrenchConditioner::new(
        &config.conditioning,
        &config.payload,
        config.sensor_from_tool,
        rate_hz,
    )
}

/// Plausibility checks for a sensor that sends at `rate_hz`.
fn watch_of(config: &Config, rate_hz: f64) -> SensorWatch {
    let tip_in_sensor_m = config.sensor_from_tool.translation();
    SensorWatch::new(
        &RecordWatchConfig::default(),
        rate_hz,
        config.range,
        tip_in_sensor_m,
    )
}

/// Detects a load beyond the sensor's range, which the sensor does not report. A sample with an
/// isolated jump was already left out.
fn within_range(
    condition: SensorCondition,
    wrench: &Wrench<Sensor>,
    range: &[f64; 6],
) -> SensorCondition {
    let load = wrench.vector();
    let beyond = (0..6).any(|i| load[i].abs() > range[i]);
    match condition {
        SensorCondition::Good if beyond => SensorCondition::Saturated,
        condition => condition,
    }
}
