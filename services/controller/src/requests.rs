//! Answers requests from people and programs: `control/task`, `control/stop`, `control/select`.
//! Runs in the requesters' threads.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::json;
use tangent_control::{Clearance, EstimatorName, Phase};
use tangent_mechanics::{Base, Pose, Tool};
use tangent_runtime::bus::answer::{done_with, refused};
use tangent_runtime::{Asked, Bus, BusError, Handle, Lane, Latest, Received, StateError};
use tangent_schemas::Message;
use tangent_schemas::tangent::{Answer, ArmState, ControlState, WrenchStatus};
use tangent_schemas::topics::{self, Topic, queries};
use tangent_sensing::Validity;

use crate::error::TaskRefusal;
use crate::inputs::driven_by_another;
use crate::mailbox::{Action, Mailbox, Outcome, Time, cannot_leave};
use crate::memory::Memory;
use crate::replies::{LEAVING, NO_STATE, paused, stopped, told};

/// Maximum age of an input that counts as present when a task is to start.
pub const FRESH: Duration = Duration::from_millis(200);
/// Maximum age at which `control/state` still describes the present.
const OLD: Duration = Duration::from_millis(500);
/// Timeout of the first message of an estimator that was not subscribed to yet.
pub const FIRST_ESTIMATE: Duration = Duration::from_millis(400);

/// Law-specific part of starting a task or choosing an estimator.
pub trait Kind: Send + Sync + 'static {
    /// A task prepared for the loop.
    type Program: Send + 'static;

    /// Returns the name and the program of the task in `text`, or why it cannot be run.
    fn prepare(&self, text: &str) -> Result<(String, Self::Program), TaskRefusal>;

    /// Returns a program that moves a tool that may touch off the surface along the last known
    /// normal, or why that is impossible.
    fn leave(&self) -> Result<Self::Program, TaskRefusal>;

    /// Whether estimates of the surface arrive now; or why not.
    fn check_estimates(
        &self,
        program: &Self::Program,
        mailbox: &Mailbox<Self::Program>,
        time: Time,
    ) -> Result<(), TaskRefusal>;

    /// Makes sure that this estimator is subscribed to. No effect for a program that subscribes
    /// exactly to the estimators of its task.
    fn subscribe(
        &self,
        _: &EstimatorName,
        _: &Mailbox<Self::Program>,
        _: Time,
    ) -> Result<(), TaskRefusal> {
        Ok(())
    }
}

/// Waits for a fresh message on any of these topics, on all of them together, for
/// [`FIRST_ESTIMATE`]. Returns whether one arrived.
///
/// # Errors
/// The bus's reason if a topic cannot be read.
pub fn one_speaks<M: Message>(
    bus: &Bus,
    topics: impl Iterator<Item = Topic<M>>,
) -> Result<bool, TaskRefusal> {
    let (heard, first) = sync_channel(1);
    let mut readers = Vec::new();
    for topic in topics {
        let heard = heard.clone();
        let reader = bus.on(&topic, move |message: &Received<M>| {
            if message.age() <= FRESH {
                // One message is enough.
                let _ = heard.try_send(());
            }
        });
        readers.push(reader?);
    }
    Ok(first.recv_timeout(FIRST_ESTIMATE).is_ok())
}

/// Handler of the requests.
pub struct RequestHandler<K: Kind> {
    bus: Bus,
    mailbox: Arc<Mailbox<K::Program>>,
    kind: K,
    /// Publisher id of this controller's commands.
    own_id: [u8; 16],
    /// State that persists after the controller ends.
    memory: Arc<Memory>,
    seen: Mutex<Seen>,
}

/// The handler's own readers, separate from those of the loop.
struct Seen {
    arm: Latest<ArmState>,
    wrench: Latest<WrenchStatus>,
    control: Latest<ControlState>,
    /// Text of the task that was started last.
    task_toml: String,
}

impl<K: Kind> RequestHandler<K> {
    /// Opens the handler's readers.
    pub fn new(
        bus: &Bus,
        mailbox: &Arc<Mailbox<K::Program>>,
        kind: K,
        own_id: [u8; 16],
        memory: &Arc<Memory>,
    ) -> Result<Arc<Self>, BusError> {
        Ok(Arc::new(Self {
            seen: Mutex::new(Seen {
                arm: bus.latest(&topics::ARM_STATE)?,
                wrench: bus.latest(&topics::WRENCH_STATUS)?,
                control: bus.latest(&topics::CONTROL_STATE)?,
                task_toml: String::new(),
            }),
            bus: bus.clone(),
            mailbox: Arc::clone(mailbox),
            kind,
            own_id,
            memory: Arc::clone(memory),
        }))
    }

    /// Starts answering requests. A request that stops the arm never waits for a slow one.
    pub fn open(self: &Arc<Self>) -> Result<Vec<Handle>, BusError> {
        let [task, show, stop, select] = [(); 4].map(|()| Arc::clone(self));
        Ok(vec![
            self.bus.answer_in(
                queries::CONTROL_TASK,
                |request| match request.action.as_str() {
                    "pause" | "stop" => Lane::Urgent,
                    "start" | "start_clear" | "resume" => Lane::Slow,
                    _ => Lane::Prompt,
                },
                move |asked| task.task(&asked).into(),
            )?,
            self.bus
                .answer(queries::CONTROL_SHOW, move |_, _| show.show())?,
            self.bus.answer_in(
                queries::CONTROL_STOP,
                |_| Lane::Urgent,
                move |asked| stop.stop(time(&asked)).into(),
            )?,
            self.bus.answer_in(
                queries::CONTROL_SELECT,
                |_| Lane::Slow,
                move |asked| select.select(&asked).into(),
            )?,
        ])
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn task(&self, asked: &Asked) -> Answer {
        let time = time(asked);
        match asked.request.action.as_str() {
            "start" => self.start(&asked.request.argument, time, false),
            "start_clear" => self.start(&asked.request.argument, time, true),
            "pause" => self.ask(Action::Pause, time, |phase| paused(phase).to_owned()),
            "resume" => self.ask(Action::Resume, time, |_| "going on".to_owned()),
            "stop" => self.stop(time),
            "status" => self.status(),
            other => refused(format!(
                "unknown action `{other}`: start or start_clear (with a task as TOML), pause, resume, stop or status"
            )),
        }
    }

    fn stop(&self, time: Time) -> Answer {
        // A start that is still being prepared must not take effect after the stop.
        self.mailbox.stop_asked(time.received);
        let name = EstimatorName::new();
        let answer = match self.mailbox.ask(Action::Stop, time) {
            Ok(Outcome::MayTouch) => self.leave(time),
            outcome => told(outcome, &name, |phase| stopped(phase).to_owned()),
        };
        let arm = self.seen().arm.fresh(FRESH).map(|arm| arm.message.clone());
        match arm {
            Some(arm) if !answer.done && !arm.ready => refused(format!(
                "{}; the arm reports: {}",
                answer.message, arm.not_ready_reason
            )),
            _ => answer,
        }
    }

    /// Moves the tool off a surface that it may have touched before this controller started.
    fn leave(&self, time: Time) -> Answer {
        let ready = (self.seen().arm.fresh(FRESH)).is_some_and(|arm| arm.message.ready);
        if !ready {
            return refused(cannot_leave(self.mailbox.phase()).to_string());
        }
        match self.kind.leave() {
            Ok(program) => {
                let action = Action::Start {
                    program: Box::new(Some(program)),
                    said_clear: false,
                };
                self.ask(action, time, |_| LEAVING.to_owned())
            }
            Err(reason) => refused(reason.to_string()),
        }
    }

    /// Starts a task; `said_clear`: a person has checked that the tool is free.
    fn start(&self, text: &str, time: Time, said_clear: bool) -> Answer {
        if said_clear {
            tracing::warn!("a task is started by a person who confirms that the tool hangs free");
        }
        // What the task before has learnt may wait still.
        self.memory.lessons().take(&self.mailbox);
        let (name, program) = match self.kind.prepare(text) {
            Ok(prepared) => prepared,
            Err(reason) => return refused(reason.to_string()),
        };
        if let Err(reason) = self
            .check_inputs()
            .and_then(|()| self.kind.check_estimates(&program, &self.mailbox, time))
        {
            return refused(reason.to_string());
        }
        // Stored before anything can touch, for the next start after a crash.
        let known = self.memory.known();
        let kept = self.expect_contact(said_clear);
        // Set before the start: the recorder asks for it as soon as it sees a start.
        let before = std::mem::replace(&mut self.seen().task_toml, text.to_owned());
        let action = Action::Start {
            program: Box::new(Some(program)),
            said_clear,
        };
        let mut answer = self.ask(action, time, |_| format!("task \"{name}\" started"));
        if !answer.done {
            self.seen().task_toml = before;
            if !self.mailbox.phase().is_active() {
                let _ = self.memory.set(known);
            }
        } else if let Err(reason) = kept {
            answer.message +=
                &format!("; after a crash it would not be known that the tool touched: {reason}");
        }
        answer
    }

    /// Stores that the tool may touch something from now on, in front of its present position. An
    /// earlier stored doubt stays, unless a person has checked the tool.
    fn expect_contact(&self, said_clear: bool) -> Result<(), StateError> {
        let Some(arm) = self
            .seen()
            .arm
            .get()
            .map(|arm| arm.message.tool_pose.clone())
        else {
            return Ok(());
        };
        let Ok(pose) = Pose::<Base, Tool>::try_from(&arm) else {
            return Ok(());
        };
        let (normal, position) = (-pose.z_axis(), pose.translation());
        if said_clear {
            self.memory.set(Clearance::Possible { normal, position })
        } else {
            self.memory.expect_contact(normal, position)
        }
    }

    /// The text of the task that was started last, for the recorder.
    fn show(&self) -> Answer {
        match self.seen().task_toml.as_str() {
            "" => refused("no task was started yet"),
            text => done_with("the task started last", &json!({ "task_toml": text })),
        }
    }

    /// Checks that arm and wrench are present and usable now.
    fn check_inputs(&self) -> Result<(), TaskRefusal> {
        if let Some(second) = self.bus.refused().iter().find(|r| r.who.is_some()) {
            return Err(TaskRefusal::SecondPublisher(second.to_string()));
        }
        let mut seen = self.seen();
        match seen.arm.fresh(FRESH) {
            None => return Err(TaskRefusal::NoArm),
            Some(arm) if driven_by_another(&arm.message, self.own_id).is_some() => {
                let driver = with_host(&arm.message.commanded_by);
                return Err(TaskRefusal::DrivenByAnother(driver));
            }
            Some(arm) if !arm.message.ready => {
                let reason = arm.message.not_ready_reason.to_string();
                return Err(TaskRefusal::ArmNotReady(reason));
            }
            Some(_) => {}
        }
        let status = seen.wrench.fresh(FRESH).ok_or(TaskRefusal::NoWrench)?;
        let validity = Validity::from(status.message.validity);
        if validity.is_valid() {
            return Ok(());
        }
        Err(TaskRefusal::WrenchInvalid {
            reason: validity.reason(),
            status: status.message.status_text.to_string(),
        })
    }

    fn select(&self, asked: &Asked) -> Answer {
        let (request, time) = (&asked.request, time(asked));
        let force = match request.action.as_str() {
            "" | "select" => false,
            "force" => true,
            other => {
                return refused(format!("unknown action `{other}`: select or force"));
            }
        };
        let text = request.argument.trim();
        let Ok(name) = EstimatorName::from(text) else {
            return refused("an estimator's name has at most 64 bytes");
        };
        if name.is_empty() {
            return refused("name an estimator, as in `tangent estimator list`");
        }
        if let Err(reason) = self.kind.subscribe(&name, &self.mailbox, time) {
            return refused(reason.to_string());
        }
        let words =
            |_| format!("{name} in use; the normal in use turns to its normal at a bounded rate");
        let first = self.ask(Action::Select { name, force }, time, words);
        if first.done {
            return first;
        }
        // An estimator that the task does not name is read from the next cycle on: ask again then.
        let cycles = self.mailbox.cycles();
        for _ in 0..50 {
            if self.mailbox.cycles() >= cycles + 3 {
                return self.ask(Action::Select { name, force }, time, words);
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
        first
    }

    /// Sends a request to the loop; `done` describes the result, given the phase in which the
    /// request was received.
    fn ask(
        &self,
        action: Action<K::Program>,
        time: Time,
        done: impl Fn(Phase) -> String,
    ) -> Answer {
        let name = match &action {
            Action::Select { name, .. } => *name,
            _ => EstimatorName::new(),
        };
        told(self.mailbox.ask(action, time), &name, done)
    }

    fn status(&self) -> Answer {
        let mut seen = self.seen();
        let Some(newest) = seen.control.get() else {
            return done_with(NO_STATE, &json!({"phase": Phase::Idle.name()}));
        };
        let (s, age) = (&newest.message, newest.age());
        if age > OLD {
            // The last state received is reported with its age.
            return done_with(
                format!(
                    "no control/state for {:.1} s: {NO_STATE}; last known: {} {}",
                    age.as_secs_f64(),
                    s.task,
                    s.phase_text
                ),
                &json!({
                    "phase": null, "phase_before": s.phase_text.as_str(), "task": s.task.as_str(),
                    "activation": s.activation, "force_n": null, "age_s": age.as_secs_f64(),
                }),
            );
        }
        let force_n = s.force_n.is_finite().then_some(s.force_n);
        let mut words = s.phase_text.to_string();
        if !s.task.is_empty() {
            words = format!(
                "{}: {words}, {:.0} % of the path",
                s.task,
                100.0 * s.path_progress
            );
            if let Some(force_n) = force_n {
                words.push_str(&format!(", {force_n:.2} of {:.2} N", s.force_reference_n));
            } else if s.wrench_validity != Validity::Valid as u8 {
                words.push_str(", no usable wrench");
            }
        }
        if s.paused {
            words.push_str("; paused");
        }
        let zero_age_s = (s.zero_age_s >= 0.0).then_some(s.zero_age_s);
        let zero_bound_n = (s.zero_bound_n >= 0.0).then_some(s.zero_bound_n);
        if let Some(age_s) = zero_age_s {
            words.push_str(&format!("; zero {age_s:.0} s old"));
            if let Some(bound_n) = zero_bound_n {
                words.push_str(&format!(", off by {bound_n:.2} N at most"));
            }
        }
        let waits_for_tare = s.phase == Phase::Tare as u8;
        let refused = Some(self.mailbox.tare_reason()).filter(|r| waits_for_tare && !r.is_empty());
        if let Some(reason) = &refused {
            words.push_str(&format!(
                "; the tare is refused and will be requested again: {reason}"
            ));
        }
        if !s.fault.is_empty() {
            words.push_str(&format!("; {}", s.fault));
        }
        words.push_str(&format!(" ({:.0} ms ago)", age.as_secs_f64() * 1e3));
        done_with(
            words,
            &json!({
                "phase": s.phase_text.as_str(), "task": s.task.as_str(), "activation": s.activation,
                "estimator": s.estimator.as_str(), "estimator_cause": s.estimator_cause.as_str(),
                "estimator_switches": s.estimator_switches, "path_progress": s.path_progress,
                "force_n": force_n, "force_reference_n": s.force_reference_n, "paused": s.paused,
                "contact_lost_count": s.contact_lost_count, "fault": s.fault.as_str(),
                "tare_refused": refused, "zero_age_s": zero_age_s, "zero_bound_n": zero_bound_n,
                "age_s": age.as_secs_f64(),
            }),
        )
    }
}

/// The source `SERVICE/HOST-PROCESS` as text that names its host.
fn with_host(source: &str) -> String {
    let instance = source.rsplit('/').next().unwrap_or_default();
    match instance.rsplit_once('-') {
        Some((host, _)) => format!("{source} on host {host}"),
        None => source.to_owned(),
    }
}

fn time(asked: &Asked) -> Time {
    Time {
        received: asked.received,
        deadline: asked.deadline,
    }
}
