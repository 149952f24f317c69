//! Answers people and programs: `control/task`, `control/stop`, `control/select`. Runs in the askers' threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::json;
use tangent_control::{EstimatorName, Phase};
use tangent_runtime::bus::answer::{done_with, refused};
use tangent_runtime::{Bus, BusError, Handle, Latest};
use tangent_schemas::Message;
use tangent_schemas::tangent::{Answer, ArmState, ControlState, Request, WrenchStatus};
use tangent_schemas::topics::{self, Topic, queries};
use tangent_sensing::Validity;

use crate::inputs::driven_by_another;
use crate::mailbox::{Ask, Mailbox, Outcome};

/// Older than this, an input does not count as there when a task is to start.
pub const FRESH: Duration = Duration::from_millis(200);
/// How long an estimator that nobody listened to yet is waited for.
pub const FIRST_ESTIMATE: Duration = Duration::from_millis(400);

/// What differs from law to law when a task is started or an estimator chosen.
pub trait Kind: Send + Sync + 'static {
    /// A task made ready for the loop.
    type Program: Send + 'static;

    /// The task of this text with its name; or why it cannot be run.
    fn prepare(&self, text: &str) -> Result<(String, Self::Program), String>;

    /// Whether what is known of the surface comes in, now; or why not.
    fn check_estimates(
        &self,
        program: &Self::Program,
        mailbox: &Mailbox<Self::Program>,
    ) -> Result<(), String>;

    /// Makes sure that this estimator is listened to. A program that listens to all that its task names, and to no others, leaves it
    /// at that.
    fn hear(&self, _: &EstimatorName, _: &Mailbox<Self::Program>) -> Result<(), String> {
        Ok(())
    }
}

/// Whether something fresh comes on one of these topics.
///
/// # Errors
/// The bus's reason, where a topic cannot be read.
pub fn one_speaks<M: Message>(
    bus: &Bus,
    topics: impl Iterator<Item = Topic<M>>,
) -> Result<bool, String> {
    for topic in topics {
        let heard = bus.subscribe(&topic, 1).map_err(|e| e.to_string())?;
        let first = heard.recv_timeout(FIRST_ESTIMATE);
        if first.is_some_and(|message| message.age() <= FRESH) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Where requests are answered.
pub struct Desk<K: Kind> {
    bus: Bus,
    mailbox: Arc<Mailbox<K::Program>>,
    kind: K,
    /// Under which this controller's commands travel.
    own_id: [u8; 16],
    seen: Mutex<Seen>,
}

/// The desk's own readers: the loop's belong to the loop.
struct Seen {
    arm: Latest<ArmState>,
    wrench: Latest<WrenchStatus>,
    control: Latest<ControlState>,
    /// The task that was started last, as it came.
    task_toml: String,
}

impl<K: Kind> Desk<K> {
    /// Opens the desk's readers.
    pub fn new(
        bus: &Bus,
        mailbox: &Arc<Mailbox<K::Program>>,
        kind: K,
        own_id: [u8; 16],
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
        }))
    }

    /// Begins to answer.
    pub fn open(self: &Arc<Self>) -> Result<Vec<Handle>, BusError> {
        let [task, show, stop, select] = [(); 4].map(|()| Arc::clone(self));
        Ok(vec![
            self.bus
                .answer(queries::CONTROL_TASK, move |_, request| task.task(&request))?,
            self.bus
                .answer(queries::CONTROL_SHOW, move |_, _| show.show())?,
            self.bus.answer(queries::CONTROL_STOP, move |_, _| {
                stop.ask(Ask::Stop, "retracting")
            })?,
            self.bus
                .answer(queries::CONTROL_SELECT, move |_, request| {
                    select.select(&request)
                })?,
        ])
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn task(&self, request: &Request) -> Answer {
        match request.action.as_str() {
            "start" => self.start(&request.argument),
            "pause" => self.ask(Ask::Pause, "paused: pressing, not sliding"),
            "resume" => self.ask(Ask::Resume, "going on"),
            "stop" => self.ask(Ask::Stop, "retracting"),
            "status" => self.status(),
            other => refused(format!(
                "unknown action `{other}`: start (with a task as TOML), pause, resume, stop or status"
            )),
        }
    }

    fn start(&self, text: &str) -> Answer {
        let (name, program) = match self.kind.prepare(text) {
            Ok(prepared) => prepared,
            Err(reason) => return refused(reason),
        };
        if let Err(reason) = self
            .check_inputs()
            .and_then(|()| self.kind.check_estimates(&program, &self.mailbox))
        {
            return refused(reason);
        }
        // Before the start: the recorder asks as soon as it sees one.
        let before = std::mem::replace(&mut self.seen().task_toml, text.to_owned());
        let answer = self.ask(
            Ask::Start(Box::new(Some(program))),
            &format!("task \"{name}\" started"),
        );
        if !answer.done {
            self.seen().task_toml = before;
        }
        answer
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
        let mut seen = self.seen();
        match seen.arm.fresh(FRESH) {
            None => return Err("no arm/state: is rtde running, and the robot reached?".into()),
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

    fn select(&self, request: &Request) -> Answer {
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
        if let Err(reason) = self.kind.hear(&name, &self.mailbox) {
            return refused(reason);
        }
        let words = format!("{name} in use; what is steered by turns to it at a bounded rate");
        let first = self.ask(Ask::Select { name, force }, &words);
        if first.done {
            return first;
        }
        // One that the task does not name is read from the next cycle on: ask again then.
        let cycles = self.mailbox.cycles();
        for _ in 0..50 {
            if self.mailbox.cycles() >= cycles + 3 {
                return self.ask(Ask::Select { name, force }, &words);
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
        first
    }

    fn ask(&self, ask: Ask<K::Program>, done: &str) -> Answer {
        let name = match &ask {
            Ask::Select { name, .. } => *name,
            _ => EstimatorName::new(),
        };
        match self.mailbox.ask(ask) {
            None => refused(NO_LOOP),
            Some(Outcome::Refused(error)) => refused(error.to_string()),
            Some(Outcome::SwitchRefused(why)) => refused(why.error(&name).to_string()),
            Some(Outcome::Done { activation }) => done_with(
                done,
                &json!({"activation": activation, "phase": self.mailbox.phase().name()}),
            ),
        }
    }

    fn status(&self) -> Answer {
        let mut seen = self.seen();
        let Some(newest) = seen.control.get() else {
            return done_with(NO_LOOP, &json!({"phase": Phase::Idle.name()}));
        };
        let s = &newest.message;
        let words = if s.task.is_empty() {
            s.phase_text.to_string()
        } else {
            format!(
                "{}: {}, {:.0} % of the path, {:.2} of {:.2} N{}{}",
                s.task,
                s.phase_text,
                100.0 * s.path_progress,
                s.force_n,
                s.force_reference_n,
                if s.fault.is_empty() { "" } else { "; " },
                s.fault
            )
        };
        done_with(
            words,
            &json!({
                "phase": s.phase_text.as_str(), "task": s.task.as_str(), "activation": s.activation,
                "estimator": s.estimator.as_str(), "estimator_cause": s.estimator_cause.as_str(),
                "estimator_switches": s.estimator_switches, "path_progress": s.path_progress,
                "force_n": s.force_n, "force_reference_n": s.force_reference_n,
                "contact_lost_count": s.contact_lost_count, "fault": s.fault.as_str(),
                "age_s": newest.age().as_secs_f64(),
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

/// Nobody turns the loop.
pub const NO_LOOP: &str =
    "the loop does not run: no arm/state comes in; is rtde running, and the robot reached?";
