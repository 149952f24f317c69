//! Conditioning of one reading of the sensor to the wrench at the tool, with its validity.

use nalgebra::{Vector3, Vector6};
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};

use crate::tare::averaging::Averaging;
use crate::{
    LowPass, LowPassState, Payload, SensingError, SensorMotion, Tare, TareConfig, TareGround,
    TareRefusal, Validity,
};

/// Settings of the wrench's conditioning. Payload and mounting of the sensor are given separately.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ConditioningConfig {
    /// Cut-off (-3 dB) of the low-pass, Hz; 0: off. Its delay is about 0.2251 / cut-off.
    pub filter_cutoff_hz: f64,
    /// Time for which the fault of one reading stays visible, s, so that a reader that is slower
    /// than the sensor does not miss it.
    pub fault_hold_s: f64,
    /// Largest age of the arm's orientation with which the payload is compensated, s.
    pub orientation_age_max_s: f64,
    /// Acceleration of gravity in base axes, m/s². It differs for an arm on a wall or a ceiling.
    pub gravity_in_base_m_per_s2: [f64; 3],
    /// Conditions of a tare.
    pub tare: TareConfig,
}

impl Default for ConditioningConfig {
    fn default() -> Self {
        Self {
            filter_cutoff_hz: 30.0,
            fault_hold_s: 0.01,
            orientation_age_max_s: 0.1,
            gravity_in_base_m_per_s2: [0.0, 0.0, -9.80665],
            tare: TareConfig::default(),
        }
    }
}

/// Condition of a reading, from the sensor itself or from a [`crate::SensorWatch`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SensorCondition {
    /// The reading is good.
    #[default]
    Good,
    /// A strain gauge is saturated.
    Saturated,
    /// The sensor reports another error.
    Error,
    /// Records repeat ([`crate::RecordWatch`]).
    Frozen,
    /// One axis repeats ([`crate::RecordWatch`]).
    AxisStuck,
    /// Too many readings jump in a way that no load can cause ([`crate::JumpWatch`]).
    Implausible,
    /// The zero has jumped ([`crate::StepWatch`]).
    ZeroJumped,
}

/// One reading of the sensor and the pose of the arm.
///
/// ```
/// use tangent_mechanics::{Pose, Sensor, Wrench};
/// use tangent_sensing::{Reading, SensorCondition};
/// let reading = Reading {
///     condition: SensorCondition::Saturated,
///     missed: 2,
///     ..Reading::new(1.25, Wrench::<Sensor>::zero(), Pose::identity())
/// };
/// assert_eq!(reading.time_s, 1.25);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Time of measurement on a monotonic clock, s.
    pub time_s: f64,
    /// Reading of the sensor before tare: N and Nm, sensor axes.
    pub wrench: Wrench<Sensor>,
    /// Condition of the reading.
    pub condition: SensorCondition,
    /// Number of readings lost before this one.
    pub missed: u32,
    /// Measured pose of the tool and its age (s); `None` while the arm publishes no state. Not
    /// needed without a payload.
    pub base_from_tool: Option<(Pose<Base, Tool>, f64)>,
    /// Measured motion, if it is accurate enough to compensate the payload's inertia; otherwise
    /// only its weight is compensated.
    pub motion: Option<SensorMotion>,
}

impl Reading {
    /// A good reading with none lost before it, of a sensor at `base_from_tool` now.
    pub fn new(time_s: f64, wrench: Wrench<Sensor>, base_from_tool: Pose<Base, Tool>) -> Self {
        Self {
            time_s,
            wrench,
            condition: SensorCondition::Good,
            missed: 0,
            base_from_tool: Some((base_from_tool, 0.0)),
            motion: None,
        }
    }
}

/// Wrench that the environment exerts on the tool, with its validity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionedWrench {
    /// Wrench at the tool's origin, tool axes. Always finite; while not valid, the last good one.
    pub wrench: Wrench<Tool>,
    /// Whether `wrench` can be used.
    pub validity: Validity,
    /// Delay of the filter for slow signals, s.
    pub delay_s: f64,
    /// Zero that is subtracted, N and Nm; 0 before the first tare.
    pub bias: Wrench<Sensor>,
    /// Age of the zero, s; `None` before the first tare.
    pub bias_age_s: Option<f64>,
    /// Filtered reading without the payload, before the zero is subtracted. No zero hides a load in
    /// it.
    pub untared: Wrench<Sensor>,
    /// Whether a person had confirmed that the tool was free when the zero was taken.
    pub said_clear: bool,
    /// Zero to which the limit on the untared reading is relative ([`Tare::shown`]), and its age,
    /// s; `None` before the first tare.
    pub reference: Option<(Wrench<Sensor>, f64)>,
}

/// Tare, payload compensation, low-pass and eq. (2) of Tugal et al. The state is in
/// [`WrenchConditionerState`].
///
/// ```
/// use tangent_mechanics::{Pose, Sensor, Wrench};
/// use tangent_sensing::{
///     ConditioningConfig, Payload, Reading, WrenchConditioner, WrenchConditionerState,
/// };
/// let (config, payload) = (ConditioningConfig::default(), Payload::default());
/// let conditioner = WrenchConditioner::new(&config, &payload, Pose::identity(), 1000.0)?;
/// let mut state = WrenchConditionerState::default();
/// let reading = Reading::new(0.001, Wrench::<Sensor>::zero(), Pose::identity());
/// assert!(conditioner.update(&mut state, &reading).validity.is_valid());
/// # Ok::<(), tangent_sensing::SensingError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct WrenchConditioner {
    filter: LowPass,
    payload: Payload,
    sensor_from_tool: Pose<Sensor, Tool>,
    tool_from_sensor: Pose<Tool, Sensor>,
    gravity_in_base: Vector3<f64>,
    fault_hold_s: f64,
    orientation_age_max_s: f64,
    tare: TareConfig,
}

/// State of a [`WrenchConditioner`]. A new one is the reset: no zero, and an empty filter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WrenchConditionerState {
    filter: LowPassState<6>,
    /// Filter output after the last good reading.
    output: Vector6<f64>,
    tare: Option<Tare>,
    /// Last good zero, against which a new one is judged, and the one before it.
    reference: Option<Tare>,
    reference_before: Option<Tare>,
    averaging: Option<Averaging>,
    /// Evidence that the tool is free of contact during the present average.
    ground: TareGround,
    outcome: Option<Result<Tare, TareRefusal>>,
    /// Last fault of a reading, and its time.
    fault: Option<(Validity, f64)>,
    /// Number of readings lost or unusable since the last one in the filter.
    skipped: u32,
}

impl WrenchConditioner {
    /// Conditioner for a sensor that is mounted at `sensor_from_tool` and read at `sample_rate_hz`.
    ///
    /// # Errors
    /// A parameter is out of its range.
    pub fn new(
        config: &ConditioningConfig,
        payload: &Payload,
        sensor_from_tool: Pose<Sensor, Tool>,
        sample_rate_hz: f64,
    ) -> Result<Self, SensingError> {
        payload.check()?;
        config.tare.check()?;
        for (key, value) in [
            ("fault_hold_s", config.fault_hold_s),
            ("orientation_age_max_s", config.orientation_age_max_s),
        ] {
            SensingError::unless((0.0..=10.0).contains(&value), key, value, "from 0 to 10")?;
        }
        for value in config.gravity_in_base_m_per_s2 {
            let allowed = "finite and below 20";
            SensingError::unless(
                value.abs() < 20.0,
                "gravity_in_base_m_per_s2",
                value,
                allowed,
            )?;
        }
        Ok(Self {
            filter: LowPass::new(config.filter_cutoff_hz, sample_rate_hz)?,
            payload: payload.clone(),
            sensor_from_tool,
            tool_from_sensor: sensor_from_tool.inverse(),
            gravity_in_base: config.gravity_in_base_m_per_s2.into(),
            fault_hold_s: config.fault_hold_s,
            orientation_age_max_s: config.orientation_age_max_s,
            tare: config.tare.clone(),
        })
    }

    /// Changes the cut-off, Hz. The output makes no step.
    ///
    /// # Errors
    /// The cut-off is not from 0 to 0.45 of the sample rate; the one before stays in force.
    pub fn set_filter_cutoff_hz(&mut self, cutoff_hz: f64) -> Result<(), SensingError> {
        self.filter = LowPass::new(cutoff_hz, self.filter.sample_rate_hz())?;
        Ok(())
    }

    /// The filter in force.
    pub fn filter(&self) -> &LowPass {
        &self.filter
    }

    /// Begins to average the zero over `tare.duration_s`.
    /// [`WrenchConditionerState::take_tare_outcome`] returns the outcome. `ground` is the evidence
    /// that the tool is free of contact. A zero that a person has confirmed is not judged against
    /// the last one or the rating.
    pub fn start_tare(&self, state: &mut WrenchConditionerState, ground: TareGround) {
        let samples = (self.tare.duration_s * self.filter.sample_rate_hz()).round();
        state.outcome = None;
        state.ground = ground;
        state.averaging = Some(Averaging::new(samples as u32));
    }

    /// Conditions of a tare, and the stated drift of the zero.
    pub fn tare_config(&self) -> &TareConfig {
        &self.tare
    }

    /// Conditions one reading: tare, payload, filter and eq. (2).
    ///
    /// Sign: all wrenches are those of the environment on the robot, so pressing with an aligned
    /// tool gives a force along `-z_tool`. Tugal et al. use the opposite sign in their eq. (2):
    /// their `f_e` is the force of the robot on the environment. They also use the lever `r_cs`
    /// from sensor to contact point with a plus, although the moment about the contact point has
    /// the lever `-r_cs`. This method uses the rigid frame change `τ_tool = R (τ_sensor - r × f)`,
    /// with `r` the tool's origin in the sensor's frame.
    pub fn update(
        &self,
        state: &mut WrenchConditionerState,
        reading: &Reading,
    ) -> ConditionedWrench {
        let orientation = self.orientation(reading);
        let fault = self.fault(reading);
        if let Some(fault) = fault {
            state.fault = Some((fault, reading.time_s));
            state.skipped = state.skipped.saturating_add(1);
        } else {
            self.take(state, reading, &orientation);
        }
        if let Some(averaging) = &mut state.averaging {
            let refusal = match (fault, orientation) {
                (Some(fault), _) => Some(TareRefusal::BadReading(fault)),
                (None, Err(validity)) => Some(TareRefusal::NoOrientation(validity)),
                (None, Ok(_)) => None,
            };
            let outcome = match refusal {
                Some(refusal) => Some(Err(refusal)),
                None => {
                    let (ground, before) = (state.ground, state.reference.as_ref());
                    let taken = averaging.take(
                        &self.tare,
                        &(reading.wrench - self.payload_wrench(reading)),
                        reading.base_from_tool.as_ref().map(|(pose, _)| pose),
                        reading.time_s,
                    );
                    taken.map(|outcome| {
                        outcome.and_then(|tare| {
                            self.tare.judge(&tare, ground, before)?;
                            Ok(tare.following(ground, before))
                        })
                    })
                }
            };
            if let Some(outcome) = outcome {
                self.end_tare(state, outcome);
            }
        }
        let validity = match (
            state.held_fault(reading.time_s, self.fault_hold_s),
            orientation,
        ) {
            (Some(fault), _) => fault,
            (None, Err(validity)) => validity,
            (None, Ok(())) => Validity::Valid,
        };
        ConditionedWrench {
            wrench: self
                .tool_from_sensor
                .transform_wrench(&Wrench::from_vector(&state.output)),
            validity,
            delay_s: self.filter.delay_s(),
            bias: state.bias(),
            bias_age_s: state.bias_age_s(reading.time_s),
            said_clear: state
                .tare
                .is_some_and(|t| t.ground == TareGround::SaidClear),
            untared: Wrench::from_vector(&state.output) + state.bias(),
            reference: state.reference.map(|last| {
                (
                    last.shown.bias,
                    (reading.time_s - last.shown.time_s).max(0.0),
                )
            }),
        }
    }

    /// Fault of the reading itself.
    fn fault(&self, reading: &Reading) -> Option<Validity> {
        match reading.condition {
            SensorCondition::Saturated => Some(Validity::Saturated),
            SensorCondition::Error => Some(Validity::SensorError),
            SensorCondition::Frozen => Some(Validity::Frozen),
            SensorCondition::AxisStuck => Some(Validity::AxisStuck),
            SensorCondition::Implausible => Some(Validity::Implausible),
            SensorCondition::ZeroJumped => Some(Validity::ZeroJumped),
            SensorCondition::Good if !reading.wrench.is_finite() => Some(Validity::NotFinite),
            SensorCondition::Good => None,
        }
    }

    /// Whether the payload can be compensated; if not, why.
    fn orientation(&self, reading: &Reading) -> Result<(), Validity> {
        if self.payload.mass_kg == 0.0 {
            return Ok(());
        }
        match &reading.base_from_tool {
            None => Err(Validity::Missing),
            Some((pose, _)) if !pose.rotation().coords.iter().all(|x| x.is_finite()) => {
                Err(Validity::NotFinite)
            }
            Some((_, age_s)) if *age_s <= self.orientation_age_max_s => Ok(()),
            Some(_) => Err(Validity::Stale),
        }
    }

    /// Wrench of the payload on the sensor in the present orientation.
    fn payload_wrench(&self, reading: &Reading) -> Wrench<Sensor> {
        match &reading.base_from_tool {
            Some((base_from_tool, _)) if self.payload.mass_kg > 0.0 => {
                let gravity_in_tool = base_from_tool.unrotate(&self.gravity_in_base);
                let gravity = self.sensor_from_tool.rotate(&gravity_in_tool);
                self.payload.wrench(&gravity, reading.motion.as_ref())
            }
            _ => Wrench::zero(),
        }
    }

    /// Passes a good reading to the filter. With a stale orientation the wrench is still computed
    /// and marked as not valid, so that the filter has no transient afterwards.
    fn take(
        &self,
        state: &mut WrenchConditionerState,
        reading: &Reading,
        orientation: &Result<(), Validity>,
    ) {
        let missed = state.skipped.saturating_add(reading.missed);
        state.skipped = 0;
        if matches!(orientation, Err(Validity::Missing | Validity::NotFinite)) {
            // The payload's weight would count as a contact force. The filter restarts once the
            // arm's state arrives.
            state.filter = LowPassState::default();
            return;
        }
        let contact = (reading.wrench - state.bias() - self.payload_wrench(reading)).vector();
        // The difference of finite numbers may overflow.
        if !contact.iter().all(|x| x.is_finite()) {
            state.fault = Some((Validity::NotFinite, reading.time_s));
            return;
        }
        // Lost readings are replaced by this one, so that the filter keeps the sensor's time.
        if missed >= self.filter.settling_samples() {
            state.filter = LowPassState::default();
        } else {
            for _ in 0..missed {
                self.filter.update(&mut state.filter, &contact);
            }
        }
        state.output = self.filter.update(&mut state.filter, &contact);
    }

    fn end_tare(&self, state: &mut WrenchConditionerState, outcome: Result<Tare, TareRefusal>) {
        state.averaging = None;
        if let Ok(tare) = &outcome {
            // The filter contains readings minus the old zero. Shifting them avoids a transient.
            let shift = (state.bias() - tare.bias).vector();
            state.filter.shift(&shift);
            state.output += shift;
            state.tare = Some(*tare);
            state.reference_before = state.reference;
            state.reference = Some(*tare);
        }
        state.outcome = Some(outcome);
    }
}

impl WrenchConditionerState {
    /// The zero in force.
    pub fn tare(&self) -> Option<&Tare> {
        self.tare.as_ref()
    }

    /// Sets a stored zero, which also becomes the last good one, or removes the one in force.
    pub fn set_tare(&mut self, tare: Option<Tare>) {
        self.tare = tare;
        self.reference = tare.or(self.reference);
        self.filter = LowPassState::default();
    }

    /// The last good zero.
    pub fn reference(&self) -> Option<&Tare> {
        self.reference.as_ref()
    }

    /// Withdraws the zero in force because it was taken in contact. The sensor is then untared, and
    /// the zero before is the last good one.
    pub fn withdraw_tare(&mut self) {
        if let Some(withdrawn) = self.tare.take() {
            self.output += withdrawn.bias.vector();
            self.filter.shift(&withdrawn.bias.vector());
            self.reference = self.reference_before.take();
        }
    }

    /// Forgets the last good zero, for another sensor.
    pub fn forget_reference(&mut self) {
        self.reference = None;
        self.reference_before = None;
    }

    /// Whether a tare is in progress.
    pub fn is_taring(&self) -> bool {
        self.averaging.is_some()
    }

    /// Cancels the tare in progress. The zero before stays in force.
    pub fn cancel_tare(&mut self) {
        self.averaging = None;
    }

    /// Outcome of the last tare; returned once.
    pub fn take_tare_outcome(&mut self) -> Option<Result<Tare, TareRefusal>> {
        self.outcome.take()
    }

    /// Resets filter and faults but keeps the zero, for a stream that restarts.
    pub fn restart(&mut self) {
        self.filter = LowPassState::default();
        self.fault = None;
        self.skipped = 0;
    }

    fn bias(&self) -> Wrench<Sensor> {
        self.tare.map_or(Wrench::zero(), |tare| tare.bias)
    }

    fn bias_age_s(&self, time_s: f64) -> Option<f64> {
        self.tare.map(|tare| (time_s - tare.time_s).max(0.0))
    }

    fn held_fault(&self, time_s: f64, hold_s: f64) -> Option<Validity> {
        let (validity, since_s) = self.fault?;
        (time_s - since_s <= hold_s).then_some(validity)
    }
}

#[cfg(test)]
mod tests;
