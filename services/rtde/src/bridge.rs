//! The bridge as a state machine. Inputs are packages of the robot, commands of the controller, and
//! the time; outputs are bytes for the robot. It owns the link, the supervisor of the robot's
//! program, the gate, and the counters.
//!
//! One cycle: [`Bridge::package`] returns [`BridgeEvent::Cycle`], the caller publishes the state,
//! and [`Bridge::command`] writes the answer. Neither allocates while streaming.

use nalgebra::Vector6;
use tangent_actuation::Command;
use tangent_actuation::lease::{Lease, LeaseDecision, Source};
use tangent_actuation::velocity::{Permission, Posture, VelocityGate, VelocityLimits};
use tangent_schemas::arm_modes::RUNTIME_PLAYING;

use crate::codec::{ControllerVersion, Package, Series, TextMessage, Value};
use crate::guiding::{GuideEnd, Guiding};
use crate::link::{Link, LinkEvent, OwnWrench};
use crate::link_error::LinkError;
use crate::program::{self, CommandCode, GUIDING_VERSION, ProgramState, RegisterMap};
use crate::reason::Reason;
use crate::sample::Sample;
use crate::sequence::Sequence;
use crate::shutdown::Ending;
use crate::supervisor::Supervisor;

/// Largest number of packages in which a soft stop is repeated.
const SOFT_STOP_PACKAGES: u32 = 25;
/// Joint speed below which the arm counts as at rest, rad/s: the measured speed of a real arm is
/// never exactly zero.
const AT_REST_RAD_PER_S: f64 = 0.01;

/// Configuration of the bridge. It learns everything else from the robot.
#[derive(Clone, Debug)]
pub struct BridgeConfig {
    /// Registers that the bridge uses.
    pub registers: RegisterMap,
    /// Name of the cell's arm model, for messages.
    pub model: String,
    /// Series of that model, if known.
    pub series: Option<Series>,
    /// Requested rate of states, Hz; `None`: the controller's own rate.
    pub rate_hz: Option<f64>,
    /// Value of the force that the robot itself feels to read with every state; `None`: none.
    pub wrench: Option<OwnWrench>,
    /// Limits of the gate.
    pub limits: VelocityLimits<6>,
    /// Smallest speed scaling at which the arm may move, 0 to 1.
    pub speed_scaling_min: f64,
    /// Seed of the session tokens; a new one at each start.
    pub seed: u64,
}

/// Meaning of a package for the caller.
#[derive(Clone, Debug, PartialEq)]
pub enum BridgeEvent {
    /// Nothing to do.
    None,
    /// Software version of the robot's controller.
    Version(ControllerVersion),
    /// A robot packet has arrived: publish the state, then call [`Bridge::command`].
    Cycle,
    /// A line from the controller, for the log.
    Text(TextMessage),
    /// The orderly shutdown is complete: close the connection.
    Finished,
}

/// Why the arm is not given to a hand.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GuideRefusal {
    /// The arm follows no commands now.
    #[error("the arm is not ready: {0}")]
    NotReady(Reason),
    /// The arm moves, or follows a task.
    #[error("a task uses the arm: stop it first with `tangent task stop`")]
    TaskRuns,
    /// The program on the robot is older than hand guiding.
    #[error(
        "the program on the robot is of version {0}, and hand guiding begins with version \
         {GUIDING_VERSION}"
    )]
    OldProgram(i32),
}

/// The bridge as a state machine, without sockets and clock.
#[derive(Debug)]
pub struct Bridge {
    config: BridgeConfig,
    link: Link,
    supervisor: Supervisor,
    gate: VelocityGate<6>,
    lease: Lease,
    period_s: f64,
    sample: Sample,
    has_sample: bool,
    cycle: u64,
    packets_lost: u64,
    sequence: Sequence,
    soft_stop: u32,
    guiding: Guiding,
    streamed: bool,
    ending: Ending,
    values: Vec<Value>,
}

impl Bridge {
    /// A bridge without a connection.
    pub fn new(config: BridgeConfig) -> Self {
        let period_s = config.series.unwrap_or(Series::Cb3).period_s();
        Self {
            link: Link::new(
                config.registers,
                &config.model,
                config.series,
                config.rate_hz,
            )
            .with_wrench(config.wrench),
            supervisor: Supervisor::new(config.speed_scaling_min, config.seed),
            gate: VelocityGate::new(config.limits.clone(), period_s),
            lease: Lease::default(),
            period_s,
            sample: Sample::default(),
            has_sample: false,
            cycle: 0,
            packets_lost: 0,
            sequence: Sequence::default(),
            soft_stop: 0,
            guiding: Guiding::default(),
            streamed: false,
            ending: Ending::No,
            values: Vec::with_capacity(16),
            config,
        }
    }

    /// Starts the link on a new connection.
    pub fn open(&mut self, now_s: f64, out: &mut Vec<u8>) -> Result<(), LinkError> {
        self.close();
        self.link.open(now_s, out)
    }

    /// Ends the link, as the connection is lost or given up. The current activation and all older
    /// ones are rejected from now on.
    pub fn close(&mut self) {
        self.link.close();
        self.supervisor.disconnected();
        self.gate.admission.latch();
        self.has_sample = false;
        self.soft_stop = 0;
        self.guiding.end(GuideEnd::Fault);
        if self.ending != Ending::No {
            self.ending = Ending::Finished;
        }
    }

    /// Takes a package of the robot.
    pub fn package(
        &mut self,
        package: Package<'_>,
        now_s: f64,
        out: &mut Vec<u8>,
    ) -> Result<BridgeEvent, LinkError> {
        match self.link.package(package, now_s, out)? {
            LinkEvent::None => Ok(BridgeEvent::None),
            LinkEvent::Text(text) => Ok(BridgeEvent::Text(text)),
            LinkEvent::Version(version) => {
                self.period_s = self.link.period_s();
                self.gate.set_period(self.period_s);
                Ok(BridgeEvent::Version(version))
            }
            LinkEvent::Paused => {
                self.ending = Ending::Finished;
                Ok(BridgeEvent::Finished)
            }
            LinkEvent::Sample => {
                self.take(*self.link.sample(), now_s)?;
                Ok(BridgeEvent::Cycle)
            }
        }
    }

    /// Checks whether an answer of the robot's controller is overdue.
    pub fn check(&self, now_s: f64) -> Result<(), LinkError> {
        self.link.check(now_s)
    }

    /// Whether a command from `source` may be passed to [`Bridge::command`]: only one source at a
    /// time commands the arm. When the lease changes hands, `activation` of the new source and all
    /// older ones are rejected, so that a task has to be started again.
    pub fn admit(&mut self, source: &Source, activation: u64, now_s: f64) -> bool {
        let rests = self.rests();
        match self.lease.admit(source, now_s, rests) {
            LeaseDecision::Held => true,
            LeaseDecision::Taken => {
                self.gate.admission.change_hands(activation);
                true
            }
            LeaseDecision::Refused => false,
        }
    }

    /// Writes the package of this cycle: after each [`BridgeEvent::Cycle`], and as a heartbeat when
    /// one is overdue. `posture` is of the last state; `arrived` is a command that was not passed
    /// before.
    pub fn command(
        &mut self,
        posture: &Posture<6>,
        arrived: Option<&Command<'_>>,
        now_s: f64,
        out: &mut Vec<u8>,
    ) -> Result<(), LinkError> {
        let mut permission = self.supervisor.permission();
        if self.soft_stop > 0 {
            permission = Permission::Off;
        } else if self.ending != Ending::No {
            permission = permission.min_with(Permission::RampDown);
        }
        if permission != Permission::Move {
            self.guiding.end(GuideEnd::Fault);
        }
        let guided = self.guiding.step(now_s);
        if guided || self.is_free() {
            // No task moves an arm that a hand guides.
            permission = Permission::Off;
        }
        let allowed = self.gate.step(self.cycle, permission, posture, arrived);
        if allowed.soft_stop {
            self.soft_stop = 1;
        }
        self.streamed = allowed.streaming;
        self.advance_ending(now_s, out)?;
        let code = if matches!(self.ending, Ending::Exit { .. }) {
            CommandCode::Exit
        } else if self.soft_stop > 0 {
            CommandCode::SoftStop
        } else if guided {
            CommandCode::Guide
        } else if allowed.streaming {
            CommandCode::Stream
        } else {
            CommandCode::Hold
        };
        let Some(recipe) = self.link.input() else {
            return Ok(());
        };
        let sequence = self.sequence.next(now_s);
        self.values.clear();
        for word in [
            code as i32,
            sequence,
            self.supervisor.session(),
            self.supervisor.flags(),
        ] {
            self.values.push(Value::Int32(word));
        }
        for v in &allowed.qd {
            self.values.push(Value::Double(*v));
        }
        self.values.push(Value::Double(self.gate.acceleration()));
        recipe.encode(&self.values, out)?;
        Ok(())
    }

    /// The session token with which to send the program, once for each time that it has to be sent.
    pub fn take_upload(&mut self) -> Option<i32> {
        self.supervisor
            .take_upload()
            .then(|| self.supervisor.session())
    }

    /// Allows the program to be sent to the robot again, even in place of another program, and a
    /// latched stop to be left.
    pub fn reset(&mut self) {
        self.supervisor.reset();
    }

    /// Sets whether the robot is another model than the cell's.
    pub fn set_wrong_model(&mut self, wrong: bool) {
        self.supervisor.set_wrong_model(wrong);
    }

    /// Has the robot decelerate and latch. The arm moves again only for a newer activation.
    pub fn stop(&mut self) {
        self.guiding.end(GuideEnd::Asked);
        self.gate.admission.latch();
        self.soft_stop = 1;
    }

    /// Lets a hand guide the arm, or lets the hand that guides it continue, for
    /// [`crate::guiding::KEEP_ALIVE_S`].
    ///
    /// # Errors
    /// Why the arm is not to be guided: it would not move for a task either, or a task uses it.
    pub fn guide(&mut self, now_s: f64) -> Result<(), GuideRefusal> {
        if !self.guiding.is_asked() {
            if let Some(reason) = self.reason() {
                return Err(GuideRefusal::NotReady(reason));
            }
            if self.streamed || !self.rests() {
                return Err(GuideRefusal::TaskRuns);
            }
            if let Some(version) = program::version(self.sample.ident)
                && version < GUIDING_VERSION
            {
                return Err(GuideRefusal::OldProgram(version));
            }
        }
        self.guiding.ask(now_s);
        Ok(())
    }

    /// Has the arm hold itself again. No effect if no hand guides it.
    pub fn end_guiding(&mut self) {
        self.guiding.end(GuideEnd::Asked);
    }

    /// Whether the arm is to be guided, and why that ended last.
    pub fn guiding(&self) -> &Guiding {
        &self.guiding
    }

    /// Begins the orderly shutdown: ramp to rest, end the program, pause the stream.
    pub fn end(&mut self, now_s: f64) {
        self.guiding.end(GuideEnd::Asked);
        if self.ending == Ending::No {
            self.ending = if self.link.is_streaming() && self.has_sample {
                Ending::ToRest { since_s: now_s }
            } else {
                Ending::Finished
            };
        }
    }

    /// Whether the orderly shutdown is complete.
    pub fn is_finished(&self) -> bool {
        self.ending == Ending::Finished
    }

    /// The last state; meaningful after the first [`BridgeEvent::Cycle`].
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    /// Number of robot packets since the bridge started.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// Time between robot packets, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Number of packets lost since the start, by the robot's clock.
    pub fn packets_lost(&self) -> u64 {
        self.packets_lost
    }

    /// Time from sending a sequence number until the robot reports it in use, s; of the newest one
    /// in use.
    pub fn latency_s(&self) -> f64 {
        self.sequence.latency_s()
    }

    /// Whether the latency was measured in this cycle.
    pub fn latency_is_new(&self) -> bool {
        self.sequence.latency_is_new()
    }

    /// The gate with its counters.
    pub fn gate(&self) -> &VelocityGate<6> {
        &self.gate
    }

    /// The lease: which source commands the arm.
    pub fn lease(&self) -> &Lease {
        &self.lease
    }

    /// The link, which knows the version of the robot's controller.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// The supervisor of the robot's program.
    pub fn supervisor(&self) -> &Supervisor {
        &self.supervisor
    }

    /// Configuration of the bridge.
    pub fn config(&self) -> &BridgeConfig {
        &self.config
    }

    /// Whether a command with a new activation would move the arm now.
    pub fn is_ready(&self) -> bool {
        self.reason().is_none()
    }

    /// Why a command with a new activation would not move the arm now; `None` if it would.
    pub fn reason(&self) -> Option<Reason> {
        if self.ending != Ending::No {
            Some(Reason::ShuttingDown)
        } else if !self.link.is_streaming() || !self.has_sample {
            Some(Reason::NoLink)
        } else if let Some(reason) = self.supervisor.reason() {
            Some(reason)
        } else if self.soft_stop > 0 {
            Some(Reason::StopAsked)
        } else if self.guiding.is_asked() || self.is_free() {
            Some(Reason::Guided)
        } else {
            None
        }
    }

    /// Whether the robot's program reports that a hand can move the arm.
    fn is_free(&self) -> bool {
        self.sample.program_state == i32::from(ProgramState::Guided.number())
    }

    fn rests(&self) -> bool {
        *self.gate.qd() == Vector6::zeros()
            && self.sample.qd.iter().all(|v| v.abs() < AT_REST_RAD_PER_S)
    }

    fn take(&mut self, sample: Sample, now_s: f64) -> Result<(), LinkError> {
        let mut lost = 0;
        if self.has_sample {
            let step_s = sample.timestamp_s - self.sample.timestamp_s;
            if step_s < 0.0 {
                return Err(LinkError::Restarted {
                    before_s: self.sample.timestamp_s,
                    now_s: sample.timestamp_s,
                });
            }
            lost = ((step_s / self.period_s).round() as u64).saturating_sub(1);
            self.packets_lost = self.packets_lost.saturating_add(lost);
        }
        let (used, before) = (sample.sequence_used, self.sample.sequence_used);
        let is_news = used != before && self.supervisor.is_present();
        self.sequence.take(used, is_news, now_s);
        self.cycle += 1;
        self.sample = sample;
        self.has_sample = true;
        self.supervisor.observe(&self.sample, lost, now_s);
        if self.soft_stop > 0 {
            let state = ProgramState::from_number(sample.program_state);
            let done = matches!(
                state,
                Some(ProgramState::Stopping | ProgramState::Stopped | ProgramState::Exiting)
            );
            self.soft_stop += 1;
            if done || self.soft_stop > SOFT_STOP_PACKAGES || !self.supervisor.is_present() {
                self.soft_stop = 0;
            }
        }
        Ok(())
    }

    fn advance_ending(&mut self, now_s: f64, out: &mut Vec<u8>) -> Result<(), LinkError> {
        let before = self.ending;
        let rests = *self.gate.qd() == Vector6::zeros();
        let gone = !self.supervisor.is_present()
            || self.sample.runtime_state != RUNTIME_PLAYING
            || self.sample.program_state == i32::from(ProgramState::Exiting.number());
        self.ending = before.advance(rests, gone, now_s);
        if self.ending == Ending::Pausing && before != Ending::Pausing {
            self.link.pause(now_s, out)?;
        }
        Ok(())
    }
}
