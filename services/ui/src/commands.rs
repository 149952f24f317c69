//! Commands of people: who may give which, what is sent to the cell, and the record of it.

use std::path::PathBuf;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use serde::Deserialize;
use tangent_runtime::bus::answer::refused;
use tangent_runtime::{Bus, Publisher, clock};
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{Answer, OperatorCommand, Request};
use tangent_schemas::topics::queries;

use crate::access::Role;
use crate::lock;
use crate::tasks;

/// Time that the cell has to answer a stop.
const STOP_PATIENCE: Duration = Duration::from_secs(2);
/// Time that the cell has to answer another command.
const PATIENCE: Duration = Duration::from_secs(8);

/// A command, as a page sends it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "action", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Starts the task of a file.
    Start {
        /// Name of the file.
        task: String,
    },
    /// Pauses the task.
    Pause,
    /// Resumes the task.
    Resume,
    /// Stops the task and retracts.
    Stop,
    /// Sets the zero of the force.
    Tare,
    /// Chooses the estimator in use.
    Estimator {
        /// Name of the estimator.
        name: String,
    },
}

impl Command {
    /// Its name in the record.
    pub fn action(&self) -> &'static str {
        match self {
            Self::Start { .. } => "start",
            Self::Pause => "pause",
            Self::Resume => "resume",
            Self::Stop => "stop",
            Self::Tare => "tare",
            Self::Estimator { .. } => "estimator",
        }
    }

    /// Its argument in the record.
    fn argument(&self) -> &str {
        match self {
            Self::Start { task } => task,
            Self::Estimator { name } => name,
            _ => "",
        }
    }

    /// The role that it needs; `None`: anyone who may read may give it.
    pub fn role(&self) -> Option<Role> {
        match self {
            // A stop brings the tool to safety, so nobody who sees the page has to look for a
            // token.
            Self::Stop => None,
            Self::Start { .. } | Self::Pause | Self::Resume | Self::Tare => Some(Role::Operator),
            Self::Estimator { .. } => Some(Role::Engineer),
        }
    }

    /// Whether the arm moves along its path after it.
    pub fn moves(&self) -> bool {
        matches!(self, Self::Start { .. } | Self::Resume)
    }
}

/// Who gives a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Who {
    /// Name of the person, or what stands in its place.
    pub name: String,
    /// `None` without a token.
    pub role: Option<Role>,
    /// Address of the browser; empty without one.
    pub address: String,
}

impl Who {
    /// Whether this person has the rights of `role`.
    pub fn may(&self, role: Role) -> bool {
        self.role.is_some_and(|own| own >= role)
    }
}

/// Sends commands to the cell, and publishes each with its outcome.
pub struct Desk {
    bus: Bus,
    record: Mutex<Publisher<OperatorCommand>>,
    tasks: PathBuf,
}

impl Desk {
    /// `tasks` is the folder of the task files.
    pub fn new(bus: &Bus, record: Publisher<OperatorCommand>, tasks: PathBuf) -> Self {
        Self {
            bus: bus.clone(),
            record: Mutex::new(record),
            tasks,
        }
    }

    /// Carries a command out if this person may give it. Blocks for some seconds at most.
    pub fn carry_out(&self, who: &Who, command: &Command) -> Answer {
        let (stamp, began) = (clock::now_ns(), Instant::now());
        let answer = match command.role() {
            Some(needed) if !who.may(needed) => refused(format!(
                "{} needs the role {needed}; {} has {}",
                command.action(),
                who.name,
                who.role.map_or("none".to_owned(), |role| role.to_string())
            )),
            _ => self.ask(command),
        };
        tracing::info!(
            "{} by {} ({}): done: {}, {}",
            command.action(),
            who.name,
            who.address,
            answer.done,
            answer.message
        );
        self.record(
            who,
            (command.action(), command.argument()),
            &answer,
            (stamp, began),
        );
        answer
    }

    /// Publishes what a person asked for (action and argument), what became of it, and when it was
    /// asked.
    pub fn record(
        &self,
        who: &Who,
        (action, argument): (&str, &str),
        answer: &Answer,
        (stamp_ns, began): (i64, Instant),
    ) {
        let record = OperatorCommand {
            header: Header::new(stamp_ns, ""),
            who: cut(&who.name),
            role: cut(&who.role.map(|role| role.to_string()).unwrap_or_default()),
            address: cut(&who.address),
            action: cut(action),
            argument: cut(argument),
            done: answer.done,
            message: answer.message.clone(),
            answered_after_s: began.elapsed().as_secs_f64(),
        };
        lock(&self.record).publish(&record);
    }

    fn ask(&self, command: &Command) -> Answer {
        let (key, action, argument, patience) = match command {
            Command::Start { task } => match tasks::text(&self.tasks, task) {
                Ok(text) => (queries::CONTROL_TASK, "start", text, PATIENCE),
                Err(error) => {
                    return refused(format!(
                        "task file {}: {error}; nothing was started",
                        self.tasks.join(task).display()
                    ));
                }
            },
            Command::Pause => (queries::CONTROL_TASK, "pause", String::new(), STOP_PATIENCE),
            Command::Resume => (queries::CONTROL_TASK, "resume", String::new(), PATIENCE),
            Command::Stop => (queries::CONTROL_STOP, "stop", String::new(), STOP_PATIENCE),
            Command::Tare => (queries::NETFT_TARE, "tare", String::new(), PATIENCE),
            Command::Estimator { name } => {
                (queries::CONTROL_SELECT, "select", name.clone(), PATIENCE)
            }
        };
        let request = Request {
            action: action.to_owned(),
            argument,
        };
        match self.bus.ask(key, &request, patience) {
            Ok(answer) => answer,
            Err(error) => refused(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tangent_runtime::bus::answer;
    use tangent_schemas::topics;

    use super::*;

    fn who(role: Option<Role>) -> Who {
        Who {
            name: "anna".to_owned(),
            role,
            address: "127.0.0.1".to_owned(),
        }
    }

    #[test]
    fn each_command_needs_its_role_and_is_published_with_its_outcome() {
        let bus = Bus::in_process("test");
        let asked = Arc::new(Mutex::new(Vec::new()));
        let mut handles = Vec::new();
        for key in [
            queries::CONTROL_TASK,
            queries::CONTROL_STOP,
            queries::CONTROL_SELECT,
            queries::NETFT_TARE,
        ] {
            let asked = Arc::clone(&asked);
            let answering = move |key: &str, request: Request| {
                asked.lock().unwrap().push((key.to_owned(), request.action));
                answer::done("as asked")
            };
            handles.push(bus.answer(key, answering).unwrap());
        }
        let records = bus.subscribe(&topics::OPERATOR_COMMAND, 64).unwrap();
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("wipe.toml"), "name = 'wipe'").unwrap();
        let publisher = bus.publisher(&topics::OPERATOR_COMMAND).unwrap();
        let desk = Desk::new(&bus, publisher, folder.path().to_owned());
        let start = Command::Start {
            task: "wipe.toml".to_owned(),
        };
        let estimator = Command::Estimator {
            name: "blend".to_owned(),
        };
        let roles = [None, Some(Role::Operator), Some(Role::Engineer)];
        for (command, key, allowed) in [
            (start, "control/task", [false, true, true]),
            (Command::Pause, "control/task", [false, true, true]),
            (Command::Resume, "control/task", [false, true, true]),
            (Command::Stop, "control/stop", [true, true, true]),
            (Command::Tare, "netft/tare", [false, true, true]),
            (estimator, "control/select", [false, false, true]),
        ] {
            for (role, allowed) in roles.into_iter().zip(allowed) {
                let before = asked.lock().unwrap().len();
                let answer = desk.carry_out(&who(role), &command);
                assert_eq!(answer.done, allowed, "{command:?} {role:?}");
                let reached = asked.lock().unwrap().len() - before;
                assert_eq!(reached, usize::from(allowed), "{command:?} {role:?}");
                if allowed {
                    assert_eq!(asked.lock().unwrap().last().unwrap().0, key);
                }
                let record = records.try_recv().unwrap().message;
                assert_eq!(record.done, allowed);
                assert_eq!(record.action.as_str(), command.action());
                assert_eq!(record.who.as_str(), "anna");
                assert!(record.header.stamp.to_ns() > 0);
            }
        }
        let missing = Command::Start {
            task: "../cell.toml".to_owned(),
        };
        let answer = desk.carry_out(&who(Some(Role::Engineer)), &missing);
        assert!(!answer.done && answer.message.contains("nothing was started"));
    }

    #[test]
    fn only_commands_of_the_grammar_are_read() {
        let read = |text: &str| serde_json::from_str::<Command>(text);
        assert_eq!(read(r#"{"action":"stop"}"#).unwrap(), Command::Stop);
        for wrong in [
            "",
            "null",
            "[]",
            r#"{"action":"explode"}"#,
            r#"{"action":"start"}"#,
            r#"{"action":"start","task":NaN}"#,
            r#"{"action":"start","task":1e999}"#,
            r#"{"action":"start","task":"a.toml","force_n":100}"#,
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
