//! One reading in, one usable (or plainly unusable) wrench at the tool out.

use nalgebra::{Vector3, Vector6};
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};

use crate::tare::Averaging;
use crate::{
    LowPass, LowPassState, Payload, SensingError, SensorMotion, Tare, TareConfig, TareGround,
    TareRefusal, Validity,
};

/// How a wrench is conditioned; what hangs on the sensor and where comes beside it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ConditioningConfig {
    /// Cut-off (-3 dB) of the low-pass, Hz; 0: off. Its delay is about 0.2251 / cut-off.
    pub filter_cutoff_hz: f64,
    /// A fault of one reading stays visible for so long, s: a reader slower than the sensor must
    /// not miss it.
    pub fault_hold_s: f64,
    /// Oldest orientation of the arm that the payload may be compensated with, s.
    pub orientation_age_max_s: f64,
    /// Acceleration of gravity in base axes, m/s²: another one for an arm on a wall or a ceiling.
    pub gravity_in_base_m_per_s2: [f64; 3],
    /// When the sensor may be tared.
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

/// What the sensor says about its own reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SensorCondition {
    /// The numbers are right.
    #[default]
    Good,
    /// A gauge is at its end.
    Saturated,
    /// Any other error of the sensor's own.
    Error,
    /// Records repeat ([`crate::RecordWatch`]).
    Frozen,
    /// One axis repeats ([`crate::RecordWatch`]).
    AxisStuck,
    /// Too many readings leap as no load can ([`crate::JumpWatch`]).
    Implausible,
}

/// One reading of the sensor and how the arm holds it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Time of measurement on any clock that only goes forward, s.
    pub time_s: f64,
    /// What the sensor reads, before tare: N and Nm, sensor axes.
    pub wrench: Wrench<Sensor>,
    /// What the sensor says about it.
    pub condition: SensorCondition,
    /// Readings lost between the one before and this one.
    pub missed: u32,
    /// Measured pose of the tool, and how old it is (s); none while the arm is silent. Not needed
    /// without a payload.
    pub base_from_tool: Option<(Pose<Base, Tool>, f64)>,
    /// Measured motion, where it is good enough to take off the payload's inertia; otherwise only
    /// its weight is.
    pub motion: Option<SensorMotion>,
}

impl Reading {
    /// A good reading with nothing lost before it, of a sensor held at `base_from_tool` now.
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

/// What the environment does to the tool, as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionedWrench {
    /// At the tool's origin, tool axes; always finite. While not valid: the last good one.
    pub wrench: Wrench<Tool>,
    /// Whether `wrench` may be acted on.
    pub validity: Validity,
    /// Delay of the filter for slow signals, s.
    pub delay_s: f64,
    /// Subtracted zero; zero while none was taken.
    pub bias: Wrench<Sensor>,
    /// Age of the zero, s; none while none was taken.
    pub bias_age_s: Option<f64>,
    /// The filtered reading without the payload, before the zero is taken off: no zero hides a load
    /// in it.
    pub untared: Wrench<Sensor>,
    /// The zero was taken on a person's word that the tool hangs free.
    pub said_clear: bool,
    /// The zero that the limit on the untared reading counts from ([`Tare::shown`]), and its age,
    /// s; none while there is none.
    pub reference: Option<(Wrench<Sensor>, f64)>,
}

/// Tare, payload, filter and eq. (2), computed once from plain numbers; all memory is in
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

/// Memory of a [`WrenchConditioner`]. A new one is the reset: no zero, an empty filter.
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
    /// What says that nothing presses while this average is taken.
    ground: TareGround,
    outcome: Option<Result<Tare, TareRefusal>>,
    /// The last fault of a reading, and when.
    fault: Option<(Validity, f64)>,
    /// Readings that never came or could not be used since the last one that went into the filter.
    skipped: u32,
}

impl WrenchConditioner {
    /// `sensor_from_tool` as mounted; `sample_rate_hz` of the readings that will come.
    ///
    /// # Errors
    /// Names the parameter that is out of range.
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

    /// Moves the cut-off while running; the output makes no step.
    ///
    /// # Errors
    /// A cut-off outside of 0 to 0.45 of the sample rate; the one before stays in force.
    pub fn set_filter_cutoff_hz(&mut self, cutoff_hz: f64) -> Result<(), SensingError> {
        self.filter = LowPass::new(cutoff_hz, self.filter.sample_rate_hz())?;
        Ok(())
    }

    /// The filter in force.
    pub fn filter(&self) -> &LowPass {
        &self.filter
    }

    /// Begins to average the zero over `tare.duration_s`;
    /// [`WrenchConditionerState::take_tare_outcome`] tells how it went. `ground` is what says that
    /// nothing presses: a zero on a person's word is not judged against the last one or the rating.
    pub fn start_tare(&self, state: &mut WrenchConditionerState, ground: TareGround) {
        let samples = (self.tare.duration_s * self.filter.sample_rate_hz()).round();
        state.outcome = None;
        state.ground = ground;
        state.averaging = Some(Averaging::new(samples as u32));
    }

    /// When a tare is refused, and how the zero drifts.
    pub fn tare_config(&self) -> &TareConfig {
        &self.tare
    }

    /// One reading through tare, payload, filter and eq. (2).
    ///
    /// Signs: the sensor, and everything here, tells what the environment does to the robot, so
    /// pressing with a square tool reads a force along `-z_tool`. Tugal et al. turn the sign around
    /// before their eq. (2) (their `f_e` is what the robot does to the environment), and take the
    /// lever `r_cs` from sensor to contact point in eq. (2) with a plus: for the moment about the
    /// contact point, the lever is `-r_cs`. Here the transform is that of a rigid frame change,
    /// `τ_tool = R (τ_sensor - r × f)` with `r` the tool's origin in the sensor's frame.
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

    /// What is wrong with the reading itself.
    fn fault(&self, reading: &Reading) -> Option<Validity> {
        match reading.condition {
            SensorCondition::Saturated => Some(Validity::Saturated),
            SensorCondition::Error => Some(Validity::SensorError),
            SensorCondition::Frozen => Some(Validity::Frozen),
            SensorCondition::AxisStuck => Some(Validity::AxisStuck),
            SensorCondition::Implausible => Some(Validity::Implausible),
            SensorCondition::Good if !reading.wrench.is_finite() => Some(Validity::NotFinite),
            SensorCondition::Good => None,
        }
    }

    /// Whether the payload can be compensated.
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

    /// What the payload does to the sensor as the arm holds it.
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

    /// A good reading goes into the filter. With an orientation that is stale but there, the wrench
    /// goes on: it is marked, and the filter need not swing in again afterwards.
    fn take(
        &self,
        state: &mut WrenchConditionerState,
        reading: &Reading,
        orientation: &Result<(), Validity>,
    ) {
        let missed = state.skipped.saturating_add(reading.missed);
        state.skipped = 0;
        if matches!(orientation, Err(Validity::Missing | Validity::NotFinite)) {
            // The payload's weight would enter as a contact force. Begin afresh when the arm
            // speaks.
            state.filter = LowPassState::default();
            return;
        }
        let contact = (reading.wrench - state.bias() - self.payload_wrench(reading)).vector();
        // A finite reading less finite numbers can still overflow.
        if !contact.iter().all(|x| x.is_finite()) {
            state.fault = Some((Validity::NotFinite, reading.time_s));
            return;
        }
        // What was lost is taken to have been as this one, so that the filter's time stays the
        // sensor's.
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
            // The filter holds readings less the old zero: shift them, or the new zero would swing
            // in.
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

    /// Takes over a zero made elsewhere, or forgets the one in force. It becomes the last good zero
    /// too.
    pub fn set_tare(&mut self, tare: Option<Tare>) {
        self.tare = tare;
        self.reference = tare.or(self.reference);
        self.filter = LowPassState::default();
    }

    /// The last good zero.
    pub fn reference(&self) -> Option<&Tare> {
        self.reference.as_ref()
    }

    /// Takes the zero in force back: it was taken in contact. The sensor is untared then, and the
    /// zero before is the last good one.
    pub fn withdraw_tare(&mut self) {
        if let Some(withdrawn) = self.tare.take() {
            self.output += withdrawn.bias.vector();
            self.filter.shift(&withdrawn.bias.vector());
            self.reference = self.reference_before.take();
        }
    }

    /// Forgets the last good zero too: another sensor.
    pub fn forget_reference(&mut self) {
        self.reference = None;
        self.reference_before = None;
    }

    /// True while an average is being taken.
    pub fn is_taring(&self) -> bool {
        self.averaging.is_some()
    }

    /// The average being taken comes to nothing; the zero before stays in force.
    pub fn cancel_tare(&mut self) {
        self.averaging = None;
    }

    /// How the last tare ended, once.
    pub fn take_tare_outcome(&mut self) -> Option<Result<Tare, TareRefusal>> {
        self.outcome.take()
    }

    /// Empties the filter and forgets faults, keeps the zero: for a stream that begins anew.
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
