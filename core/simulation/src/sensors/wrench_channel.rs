//! Path from the force/torque sensor to a law: sensor watch, conditioning and tare, as in the
//! sensor's service.
//!
//! Called by the closed loops of the systems that have such a sensor.

use tangent_control::{ContactSign, ControllerWord, UntaredLoad};
use tangent_mechanics::{Aligned, Base, Flange, Pose, Sensor as SensorFrame, Tool, Twist};
use tangent_sensing::{
    ConditionedWrench, ConditioningConfig, Payload, SensingError, SensorMotion, SensorMotionState,
    TareConfig, TareGround, WrenchConditioner, WrenchConditionerState,
};

use super::force_torque::SensorConfig;
use super::sample::SensorSample;
use super::watched::WatchedSensor;
use crate::tool::ToolConfig;

/// A simulated sensor with the conditioning behind it.
pub(crate) struct WrenchChannel {
    sensor: WatchedSensor,
    conditioner: WrenchConditioner,
    conditioning: WrenchConditionerState,
    tool_from_sensor: Pose<Tool, SensorFrame>,
    motion_state: SensorMotionState,
    /// Motion of the sensor in the newest period of the arm; `None` where it is not measured well
    /// enough for the payload's inertia.
    motion: Option<SensorMotion>,
    /// Newest wrench, and the time of its sample, s.
    newest: Option<(ConditionedWrench, f64)>,
}

impl WrenchChannel {
    /// Channel for a sensor on a tool, both as stated in the cell file.
    ///
    /// # Errors
    /// A setting of the conditioning is out of its range.
    pub fn new(
        sensing: &ConditioningConfig,
        tool: &ToolConfig,
        sensor: &SensorConfig,
    ) -> Result<Self, SensingError> {
        let flange_from_tool: Pose<Flange, Tool> =
            Pose::from_isometry(tool.flange_from_tool.isometry());
        let flange_from_sensor: Pose<Flange, SensorFrame> =
            Pose::from_isometry(tool.flange_from_sensor.isometry());
        let payload = &tool.payload;
        let sensor_from_tool = flange_from_sensor.inverse() * flange_from_tool;
        Ok(Self {
            sensor: WatchedSensor::new(sensor, sensor_from_tool.translation()),
            conditioner: WrenchConditioner::new(
                sensing,
                &Payload {
                    mass_kg: payload.mass_kg,
                    com_in_sensor_m: payload.com_in_sensor_m,
                    inertia_kg_m2: payload.inertia_kg_m2,
                },
                sensor_from_tool,
                sensor.rate_hz,
            )?,
            conditioning: WrenchConditionerState::default(),
            tool_from_sensor: flange_from_tool.inverse() * flange_from_sensor,
            motion_state: SensorMotionState::default(),
            motion: None,
            newest: None,
        })
    }

    /// Takes the arm's state in a period, with which the inertia of the payload is removed from the
    /// samples that follow. `twist` is that of the tool's origin, base axes.
    pub fn move_with(
        &mut self,
        time_s: f64,
        pose: &Pose<Base, Tool>,
        twist: &Twist<Aligned<Tool, Base>>,
    ) {
        self.motion = self
            .motion_state
            .update(time_s, pose, &self.tool_from_sensor, twist);
    }

    /// Takes a sample; `pose` is that of the tool, `pose_age_s` its age at the sample, s.
    pub fn take(&mut self, sample: &SensorSample, pose: Pose<Base, Tool>, pose_age_s: f64) {
        let felt = self.shown().filter(|c| c.bias_age_s.is_some()).copied();
        let reading = self.sensor.take(sample, &pose.translation(), felt.as_ref());
        let Some(mut reading) = reading else {
            return;
        };
        reading.base_from_tool = Some((pose, pose_age_s));
        reading.motion = self.motion;
        let conditioned = self.conditioner.update(&mut self.conditioning, &reading);
        self.newest = Some((conditioned, sample.time_s));
    }

    /// Newest conditioned wrench; `None` before the first sample.
    pub fn shown(&self) -> Option<&ConditionedWrench> {
        self.newest.as_ref().map(|(conditioned, _)| conditioned)
    }

    /// Newest conditioned wrench and its age at `time_s`, s.
    pub fn newest(&self, time_s: f64) -> Option<(ConditionedWrench, f64)> {
        let (conditioned, sampled_s) = self.newest?;
        Some((conditioned, time_s - sampled_s))
    }

    /// Largest force by which the zero may have drifted, N; `None` before the first tare.
    pub fn zero_bound_n(&self, conditioned: &ConditionedWrench) -> Option<f64> {
        let tare = self.conditioner.tare_config();
        conditioned
            .bias_age_s
            .map(|age_s| tare.drift_bound_n(age_s))
    }

    /// Reading before any zero is subtracted.
    pub fn untared_load(&self, conditioned: &ConditionedWrench) -> UntaredLoad {
        let tare: &TareConfig = self.conditioner.tare_config();
        UntaredLoad {
            beyond_reference_n: conditioned
                .reference
                .map(|(zero, _)| (conditioned.untared - zero).force.norm()),
            rated_share: tare.rated_share(&conditioned.untared),
        }
    }

    /// Carries out the law's requests: a tare with its justification, or a withdrawal of the zero.
    pub fn obey(&mut self, tare: Option<TareGround>, zero_withdrawn: bool) {
        if let Some(ground) = tare
            && !self.conditioning.is_taring()
        {
            self.conditioner.start_tare(&mut self.conditioning, ground);
        }
        if zero_withdrawn {
            self.conditioning.withdraw_tare();
        }
    }

    /// Requests a tare as an operator does; `said_clear`: the operator states that the tool hangs
    /// free.
    ///
    /// # Errors
    /// The sign of contact in the controller's state for which the tare is refused.
    pub fn ask_for_tare(
        &mut self,
        word: ControllerWord,
        said_clear: bool,
    ) -> Result<(), ContactSign> {
        if let Some(sign) = ContactSign::of(Some(word), None)
            && !(said_clear && sign.can_be_waived())
        {
            return Err(sign);
        }
        let ground = if said_clear {
            TareGround::SaidClear
        } else {
            TareGround::Assumed
        };
        self.conditioner.start_tare(&mut self.conditioning, ground);
        Ok(())
    }

    /// Replaces the sensor service by a new one, as after a crash. The last good zero is kept.
    pub fn restart(&mut self) {
        let zero = self.conditioning.reference().copied();
        self.conditioning = WrenchConditionerState::default();
        self.conditioning.set_tare(zero);
    }

    /// Removes the zeros that the sensor service has stored.
    pub fn forget_zeros(&mut self) {
        self.conditioning.forget_reference();
        self.conditioning.set_tare(None);
    }
}
