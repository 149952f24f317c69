//! The RTDE connection up to streaming: versions, recipes, start; and pausing at the end.
//!
//! It has no socket and no clock: inputs are packages and monotonic seconds, outputs are bytes and
//! events. Every connection starts from scratch, since recipes do not survive a connection.

use tangent_runtime::config::UrReading;

use crate::codec::{
    ControllerVersion, DataType, Package, Protocol, Recipe, Reply, Request, Series, Slot,
    TextMessage, Value, output_cycles,
};
use crate::link_error::{LinkError, likely_owner};
use crate::program::RegisterMap;
use crate::sample::{Sample, input_types, output_names, output_types};

/// Longest wait for the answer to a request, s.
const ANSWER_S: f64 = 2.0;
/// Longest silence while streaming, s.
const SILENCE_S: f64 = 1.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Closed,
    /// This protocol version was requested.
    ProtocolVersion(Protocol),
    ControllerVersion,
    Inputs,
    Outputs,
    Start,
    Streaming,
    Pausing,
    Paused,
}

/// Meaning of a package.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkEvent {
    /// A step of the set-up, or nothing.
    None,
    /// The controller's version is known and supported.
    Version(ControllerVersion),
    /// A state of the robot has arrived, see [`Link::sample`]; a cycle is due.
    Sample,
    /// A text message of the controller.
    Text(TextMessage),
    /// The outputs have stopped; the connection can be closed.
    Paused,
}

/// The force that the robot itself feels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OwnWrench {
    /// Value to read.
    pub reading: UrReading,
    /// Whether the cell cannot work without it.
    pub needed: bool,
}

/// One RTDE connection.
#[derive(Debug)]
pub struct Link {
    registers: RegisterMap,
    model: String,
    expected: Option<Series>,
    rate_hz: Option<f64>,
    /// As configured.
    wanted: Option<OwnWrench>,
    /// As this controller has it.
    wrench: Option<OwnWrench>,
    step: Step,
    protocol: Protocol,
    version: ControllerVersion,
    deadline_s: f64,
    input: Option<Recipe>,
    output: Option<Recipe>,
    values: Vec<Value>,
    sample: Sample,
}

impl Link {
    /// `expected`: series of the cell's `model`, if it is known. `rate_hz`: requested states per
    /// second; the controller's own rate by default.
    pub fn new(
        registers: RegisterMap,
        model: &str,
        expected: Option<Series>,
        rate_hz: Option<f64>,
    ) -> Self {
        Self {
            registers,
            model: model.to_owned(),
            expected,
            rate_hz,
            wanted: None,
            wrench: None,
            step: Step::Closed,
            protocol: Protocol::V1,
            version: ControllerVersion::default(),
            deadline_s: f64::INFINITY,
            input: None,
            output: None,
            // One more for the force that the robot itself feels.
            values: Vec::with_capacity(output_types().len() + 1),
            sample: Sample::default(),
        }
    }

    /// Requests this value of the force that the robot itself feels with every state.
    pub fn with_wrench(mut self, wrench: Option<OwnWrench>) -> Self {
        (self.wanted, self.wrench) = (wrench, wrench);
        self
    }

    /// Names of the output recipe, in order.
    fn output_names(&self) -> Vec<String> {
        let wrench = self.wrench.map(|own| own.reading.field().to_owned());
        let mut names = output_names(&self.registers);
        names.extend(wrench);
        names
    }

    /// Types of the output recipe, in order.
    fn output_types(&self) -> Vec<DataType> {
        let mut types = output_types();
        types.extend(self.wrench.map(|_| DataType::Vector6d));
        types
    }

    /// Starts a new connection: appends the first request.
    pub fn open(&mut self, now_s: f64, out: &mut Vec<u8>) -> Result<(), LinkError> {
        self.close();
        self.ask_protocol(Protocol::V2, now_s, out)
    }

    /// Resets the link, as the connection is lost.
    pub fn close(&mut self) {
        self.step = Step::Closed;
        self.protocol = Protocol::V1;
        self.wrench = self.wanted;
        self.input = None;
        self.output = None;
        self.deadline_s = f64::INFINITY;
    }

    /// Whether the robot's states are being received.
    pub fn is_streaming(&self) -> bool {
        self.step == Step::Streaming
    }

    /// Recipe of the input packages; `None` while they may not be sent.
    pub fn input(&self) -> Option<&Recipe> {
        match self.step {
            Step::Streaming => self.input.as_ref(),
            _ => None,
        }
    }

    /// Version of the controller's software; all zero until it is known.
    pub fn version(&self) -> ControllerVersion {
        self.version
    }

    /// Time between states, s: a whole number of control cycles.
    pub fn period_s(&self) -> f64 {
        let series = self.version.series();
        match (self.protocol, self.rate_hz) {
            (Protocol::V2, Some(rate_hz)) => {
                f64::from(output_cycles(series, rate_hz)) * series.period_s()
            }
            _ => series.period_s(),
        }
    }

    /// Protocol version in use.
    pub fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// The last state that was received.
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    /// Ends the stream; [`LinkEvent::Paused`] follows.
    pub fn pause(&mut self, now_s: f64, out: &mut Vec<u8>) -> Result<(), LinkError> {
        self.ask(Step::Pausing, &Request::Pause, now_s, out)
    }

    /// Checks whether an answer, or the stream, is overdue. Call it regularly.
    pub fn check(&self, now_s: f64) -> Result<(), LinkError> {
        if now_s <= self.deadline_s {
            return Ok(());
        }
        let what = match self.step {
            Step::Closed | Step::Paused => return Ok(()),
            Step::Streaming => return Err(LinkError::Silent { after_s: SILENCE_S }),
            Step::ProtocolVersion(_) => "which protocol it speaks",
            Step::ControllerVersion => "which software it runs",
            Step::Inputs => "the set-up of inputs",
            Step::Outputs => "the set-up of outputs",
            Step::Start => "the request to start",
            Step::Pausing => "the request to pause",
        };
        Err(LinkError::NoAnswer {
            what,
            after_s: ANSWER_S,
        })
    }

    /// Handles a received package. Allocates nothing while streaming.
    pub fn package(
        &mut self,
        package: Package<'_>,
        now_s: f64,
        out: &mut Vec<u8>,
    ) -> Result<LinkEvent, LinkError> {
        let reply = Reply::decode(package.kind, package.payload, self.protocol)?;
        match (self.step, reply) {
            (_, Reply::Text(text)) => Ok(LinkEvent::Text(text)),
            (Step::Streaming, Reply::Data(payload)) => self.take_sample(payload, now_s),
            // Data that were already on their way when another request was sent.
            (_, Reply::Data(_)) => Ok(LinkEvent::None),
            (Step::ProtocolVersion(asked), Reply::ProtocolVersion { accepted }) => {
                match (accepted, asked) {
                    (true, _) => {
                        self.protocol = asked;
                        let request = Request::ControllerVersion;
                        self.ask(Step::ControllerVersion, &request, now_s, out)?;
                    }
                    (false, Protocol::V2) => self.ask_protocol(Protocol::V1, now_s, out)?,
                    (false, Protocol::V1) => {
                        return Err(LinkError::Refused {
                            what: "speak RTDE protocol 2 or 1",
                        });
                    }
                }
                Ok(LinkEvent::None)
            }
            (Step::ControllerVersion, Reply::ControllerVersion(version)) => {
                self.version_answered(version, now_s, out)
            }
            (Step::Inputs, Reply::SetupInputs { recipe_id, slots }) => {
                let names = self.registers.input_names();
                let types = self.check_slots(&names, &slots, &input_types())?;
                self.input = Some(Recipe::new(recipe_id, types)?);
                self.ask_outputs(now_s, out)?;
                Ok(LinkEvent::None)
            }
            (Step::Outputs, Reply::SetupOutputs { slots, .. })
                if self.wrench.is_some_and(|own| !own.needed)
                    && slots.last() == Some(&Slot::NotFound) =>
            {
                self.wrench = None;
                self.ask_outputs(now_s, out)?;
                Ok(LinkEvent::None)
            }
            (Step::Outputs, Reply::SetupOutputs { recipe_id, slots }) => {
                let names = self.output_names();
                let types = self.check_slots(&names, &slots, &self.output_types())?;
                self.output = Some(Recipe::new(recipe_id.unwrap_or(0), types)?);
                self.ask(Step::Start, &Request::Start, now_s, out)?;
                Ok(LinkEvent::None)
            }
            (Step::Start, Reply::Start { accepted }) => {
                if !accepted {
                    return Err(LinkError::Refused {
                        what: "start sending its state",
                    });
                }
                self.step = Step::Streaming;
                self.deadline_s = now_s + SILENCE_S;
                Ok(LinkEvent::None)
            }
            (Step::Pausing, Reply::Pause { .. }) => {
                self.step = Step::Paused;
                Ok(LinkEvent::Paused)
            }
            // An answer without a request is harmless.
            _ => Ok(LinkEvent::None),
        }
    }

    fn ask(
        &mut self,
        step: Step,
        request: &Request<'_>,
        now_s: f64,
        out: &mut Vec<u8>,
    ) -> Result<(), LinkError> {
        request.encode(self.protocol, out)?;
        self.step = step;
        self.deadline_s = now_s + ANSWER_S;
        Ok(())
    }

    fn ask_protocol(
        &mut self,
        protocol: Protocol,
        now_s: f64,
        out: &mut Vec<u8>,
    ) -> Result<(), LinkError> {
        let request = Request::ProtocolVersion(protocol.number());
        self.ask(Step::ProtocolVersion(protocol), &request, now_s, out)
    }

    fn ask_outputs(&mut self, now_s: f64, out: &mut Vec<u8>) -> Result<(), LinkError> {
        let request = Request::SetupOutputs {
            frequency_hz: (self.protocol == Protocol::V2).then_some(1.0 / self.period_s()),
            names: self.output_names(),
        };
        self.ask(Step::Outputs, &request, now_s, out)
    }

    fn version_answered(
        &mut self,
        version: ControllerVersion,
        now_s: f64,
        out: &mut Vec<u8>,
    ) -> Result<LinkEvent, LinkError> {
        self.version = version;
        let series = version.series();
        if let Some(expected) = self.expected.filter(|expected| *expected != series) {
            return Err(LinkError::WrongSeries {
                version,
                found: series,
                model: self.model.clone(),
                expected,
            });
        }
        if !version.has_upper_registers() {
            return Err(LinkError::TooOld { version });
        }
        let request = Request::SetupInputs {
            names: self.registers.input_names(),
        };
        self.ask(Step::Inputs, &request, now_s, out)?;
        Ok(LinkEvent::Version(version))
    }

    fn check_slots(
        &self,
        names: &[String],
        slots: &[Slot],
        types: &[DataType],
    ) -> Result<Vec<DataType>, LinkError> {
        if slots.len() != names.len() {
            return Err(LinkError::Refused {
                what: "give one type per field",
            });
        }
        for ((name, slot), expected) in names.iter().zip(slots).zip(types) {
            match slot {
                Slot::Type(found) if found == expected => {}
                Slot::Type(found) => {
                    return Err(LinkError::WrongType {
                        name: name.clone(),
                        found: *found,
                        expected: *expected,
                    });
                }
                Slot::InUse => {
                    return Err(LinkError::InUse {
                        name: name.clone(),
                        owner: likely_owner(name),
                    });
                }
                Slot::NotFound if name == UrReading::FtRawWrench.field() => {
                    return Err(LinkError::NoRawWrench {
                        version: self.version,
                    });
                }
                Slot::NotFound => {
                    return Err(LinkError::NotFound {
                        name: name.clone(),
                        version: self.version,
                    });
                }
            }
        }
        Ok(types.to_vec())
    }

    fn take_sample(&mut self, payload: &[u8], now_s: f64) -> Result<LinkEvent, LinkError> {
        let Some(recipe) = &self.output else {
            return Ok(LinkEvent::None);
        };
        match self.protocol {
            Protocol::V1 => recipe.decode_without_id(payload, &mut self.values)?,
            Protocol::V2 => recipe.decode(payload, &mut self.values)?,
        }
        let sample = match self.wrench {
            None => Sample::from_values(&self.values),
            Some(_) => Sample::from_values_with_wrench(&self.values),
        };
        let Some(sample) = sample else {
            return Ok(LinkEvent::None);
        };
        if !sample.is_usable() {
            return Err(LinkError::NotFinite);
        }
        self.deadline_s = now_s + SILENCE_S;
        self.sample = sample;
        Ok(LinkEvent::Sample)
    }
}
