//! Answers people and programs: `control/task`, `control/stop`, `control/select`. Runs in the
//! askers' threads.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::json;
use tangent_control::{Clearance, EstimatorName, Phase};
use tangent_mechanics::{Base, Pose, Tool};
use tangent_runtime::bus::answer::{done_with, refused};
use tangent_runtime::{Asked, Bus, BusError, Handle, Lane, Latest, Received};
use tangent_schemas::Message;
use tangent_schemas::tangent::{Answer, ArmState, ControlState, WrenchStatus};
use tangent_schemas::topics::{self, Topic, queries};
use tangent_sensing::Validity;

use crate::inputs::driven_by_another;
use crate::mailbox::{Action, Mailbox, Outcome, Silence, Time, cannot_leave};
use crate::memory::Memory;

/// Older than this, an input does not count as there when a task is to start.
pub const FRESH: Duration = Duration::from_millis(200);
/// Older than this, `control/state` says nothing of now.
const OLD: Duration = Duration::from_millis(500);
/// Timeout of the first message of an estimator that was not subscribed to yet.
pub const FIRST_ESTIMATE: Duration = Duration::from_millis(400);

/// What differs from law to law when a task is started or an estimator chosen.
pub trait Kind: Send + Sync + 'static {
    /// A task made ready for the loop.
    type Program: Send + 'static;

    /// The task of this text with its name; or why it cannot be run.
    fn prepare(&self, text: &str) -> Result<(String, Self::Program), String>;

    /// Moves a tool that may touch off the surface along the last known normal; or why it cannot.
    fn leave(&self) -> Result<Self::Program, String>;

    /// Whether what is known of the surface comes in, now; or why not.
    fn check_estimates(
        &self,
        program: &Self::Program,
        mailbox: &Mailbox<Self::Program>,
        time: Time,
    ) -> Result<(), String>;

    /// Makes sure that this estimator is listened to. A program that listens to all that its task
    /// names, and to no others, leaves it at that.
    fn hear(&self, _: &EstimatorName, _: &Mailbox<Self::Program>, _: Time) -> Result<(), String> {
        Ok(())
    }
}

/// Whether something fresh comes on one of these topics. All are waited for together, for
/// [`FIRST_ESTIMATE`].
///
/// # Errors
/// The bus's reason, where a topic cannot be read.
pub fn one_speaks<M: Message>(
    bus: &Bus,
    topics: impl Iterator<Item = Topic<M>>,
) -> Result<bool, String> {
    let (heard, first) = sync_channel(1);
    let mut readers = Vec::new();
    for topic in topics {
        let heard = heard.clone();
        let reader = bus.on(&topic, move |message: &Received<M>| {
            if message.age() <= FRESH {
                // One is enough.
                let _ = heard.try_send(());
            }
        });
        readers.push(reader.map_err(|e| e.to_string())?);
    }
    Ok(first.recv_timeout(FIRST_ESTIMATE).is_ok())
}

/// Where requests are answered.
pub struct RequestHandler<K: Kind> {
    bus: Bus,
    mailbox: Arc<Mailbox<K::Program>>,
    kind: K,
    /// Under which this controller's commands travel.
    own_id: [u8; 16],
    /// What outlasts the controller.
    memory: Arc<Memory>,
    seen: Mutex<Seen>,
}

/// The handler's own readers: the loop's belong to the loop.
struct Seen {
    arm: Latest<ArmState>,
    wrench: Latest<WrenchStatus>,
    control: Latest<ControlState>,
    /// The task that was started last, as it came.
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

    /// Begins to answer. What brings the arm to rest never waits for what is slow.
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
        // A start that is still being prepared does not come after it.
        self.mailbox.stop_asked(time.received);
        let name = EstimatorName::new();
        let answer = match self.mailbox.ask(Action::Stop, time) {
            Ok(Outcome::MayTouch) => self.leave(time),
            outcome => told(outcome, &name, |phase| stopped(phase).to_owned()),
        };
        let arm = self.seen().arm.fresh(FRESH).map(|arm| arm.message.clone());
        match arm {
            Some(arm) if !answer.done && !arm.ready => refused(format!(
                "{}; the arm says: {}",
                answer.message, arm.not_ready_reason
            )),
            _ => answer,
        }
    }

    /// Off a surface that the tool may have touched before this controller started.
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
            Err(reason) => refused(reason),
        }
    }

    /// Starts a task; `said_clear`: a person has looked and says that the tool hangs free.
    fn start(&self, text: &str, time: Time, said_clear: bool) -> Answer {
        if said_clear {
            tracing::warn!("a person says that the tool hangs free, and starts a task");
        }
        let (name, program) = match self.kind.prepare(text) {
            Ok(prepared) => prepared,
            Err(reason) => return refused(reason),
        };
        if let Err(reason) = self
            .check_inputs()
            .and_then(|()| self.kind.check_estimates(&program, &self.mailbox, time))
        {
            return refused(reason);
        }
        // Before anything can touch: who starts after a crash has to know.
        let known = self.memory.known();
        let kept = self.expect_contact(said_clear);
        // Before the start: the recorder asks as soon as it sees one.
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
                &format!("; after a crash nobody would know that it touched: {reason}");
        }
        answer
    }

    /// Writes down that the tool may touch something from now on, in front of it as it stands. What
    /// was known in doubt before stays, unless a person has looked.
    fn expect_contact(&self, said_clear: bool) -> Result<(), String> {
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
        let written = if said_clear {
            self.memory.set(Clearance::Possible { normal, position })
        } else {
            self.memory.expect_contact(normal, position)
        };
        written.map_err(|error| error.to_string())
    }

    /// The text of the task that was started last, for the recorder.
    fn show(&self) -> Answer {
        match self.seen().task_toml.as_str() {
            "" => refused("no task was started yet"),
            text => done_with("the task started last", &json!({ "task_toml": text })),
        }
    }

    /// Arm and wrench are there and can be used, now.
    fn check_inputs(&self) -> Result<(), String> {
        if let Some(second) = self.bus.refused().iter().find(|r| r.who.is_some()) {
            return Err(format!(
                "{second}: end the one that does not belong to this cell, and start the task again"
            ));
        }
        let mut seen = self.seen();
        match seen.arm.fresh(FRESH) {
            None => {
                return Err(
                    "no arm/state: is the bridge (rtde or franka) running, and the robot reached?"
                        .into(),
                );
            }
            Some(arm) if driven_by_another(&arm.message, self.own_id).is_some() => {
                return Err(format!(
                    "the arm is driven by {}: start the task there, or end that controller and start the task again",
                    with_host(&arm.message.commanded_by)
                ));
            }
            Some(arm) if !arm.message.ready => {
                return Err(format!(
                    "the arm is not ready: {}",
                    arm.message.not_ready_reason
                ));
            }
            Some(_) => {}
        }
        match seen.wrench.fresh(FRESH) {
            None => Err("no wrench: is netft running, and the sensor reached?".into()),
            Some(status) => {
                let validity = Validity::from(status.message.validity);
                if validity.is_valid() {
                    return Ok(());
                }
                Err(format!(
                    "the wrench cannot be used: {} ({})",
                    validity.reason(),
                    status.message.status_text
                ))
            }
        }
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
        if let Err(reason) = self.kind.hear(&name, &self.mailbox, time) {
            return refused(reason);
        }
        let words = |_| format!("{name} in use; what is steered by turns to it at a bounded rate");
        let first = self.ask(Action::Select { name, force }, time, words);
        if first.done {
            return first;
        }
        // One that the task does not name is read from the next cycle on: ask again then.
        let cycles = self.mailbox.cycles();
        for _ in 0..50 {
            if self.mailbox.cycles() >= cycles + 3 {
                return self.ask(Action::Select { name, force }, time, words);
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
        first
    }

    /// Asks the loop; `done` says in words what was done, by the phase that the request found.
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
            // What was true then is shown as what it is: old.
            return done_with(
                format!(
                    "no control/state for {:.1} s: {NO_STATE}; before that: {} {}",
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
            let force = force_n.map_or("no usable wrench".to_owned(), |f| {
                format!("{f:.2} of {:.2} N", s.force_reference_n)
            });
            words = format!(
                "{}: {words}, {:.0} % of the path, {force}",
                s.task,
                100.0 * s.path_progress
            );
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
                "; the tare is refused and asked for again: {reason}"
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

/// `SERVICE/HOST-PROCESS` with its host in words.
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

/// An outcome in words; `name` is the estimator that a switch was about.
fn told(
    outcome: Result<Outcome, Silence>,
    name: &EstimatorName,
    done: impl Fn(Phase) -> String,
) -> Answer {
    match outcome {
        Err(silence) => refused(silence_text(silence)),
        Ok(Outcome::Refused(error)) => refused(error.to_string()),
        Ok(Outcome::SwitchRefused(why)) => refused(why.error(name).to_string()),
        Ok(Outcome::TooLate) => refused(TOO_LATE),
        Ok(Outcome::Stopped) => refused(STOPPED),
        Ok(Outcome::MayTouch) => refused(MAY_TOUCH),
        Ok(Outcome::Done { activation, phase }) => done_with(
            done(phase),
            &json!({"activation": activation, "phase": phase.name()}),
        ),
    }
}

/// What a stop comes to, by the phase after the request was taken.
fn stopped(phase: Phase) -> &'static str {
    match phase {
        Phase::Idle | Phase::Done | Phase::Fault => {
            "no task runs, and the tool has left the surface or never touched it: nothing to do"
        }
        Phase::Tare => "ended before the approach: nothing has moved",
        _ => "retracting",
    }
}

/// What a pause means in each phase.
fn paused(phase: Phase) -> &'static str {
    match phase {
        Phase::Tare => "paused before the approach: the arm stands still",
        Phase::Approach => "paused in the approach: the arm stands still, not pressing",
        Phase::Seek => "paused without contact: the arm stands still, not seeking the surface",
        Phase::Contact => "paused after the touch: pressing, not sliding",
        _ => "paused: pressing, not sliding",
    }
}

/// Why the loop did not answer, in words.
pub fn silence_text(silence: Silence) -> &'static str {
    match silence {
        Silence::Withdrawn => NO_LOOP,
        Silence::Full => "too many requests at once: nothing was done, ask again",
        Silence::Lost => {
            "the loop ended with the request in its hands: the controller has to be started again"
        }
    }
}

const TOO_LATE: &str = "the loop came to the request too late: nothing was done, ask again";
const MAY_TOUCH: &str = "no task runs, and the tool may touch something: nothing was done";
/// A stop after a restart, with the tool perhaps still pressed.
const LEAVING: &str = "no task runs, but the tool may still touch what it touched before the controller started: moving off along the last known normal";
const STOPPED: &str =
    "a stop came after this start, or the controller is ending: nothing was started, start again";

/// No cycle of the loop: nothing is known of now.
const NO_STATE: &str = "the loop does not run: no arm/state comes in; is the bridge (rtde or franka) running, and the robot reached?";
/// The loop is not called.
pub const NO_LOOP: &str = "the loop does not run: no arm/state comes in; nothing was done; is the bridge (rtde or franka) running, and the robot reached?";
