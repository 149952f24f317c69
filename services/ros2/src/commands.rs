//! Commands as services of ROS 2. A request is passed to the cell once, and its answer has one of
//! three outcomes: done, refused without effect, or unknown.
//!
//! Stop has a thread of its own, so that it never waits for another command.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tangent_runtime::config::Ros2Command;
use tangent_runtime::{Attachment, Bus, BusError, HealthReporter, PlainQuery, Rate, clock};
use tangent_schemas::cdr;
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::queries;

use crate::Ros2Error;
use crate::names::RosType;
use crate::node::{Endpoint, Node};
use crate::troubles::Troubles;
use crate::type_hash;

/// Requests that may wait in one lane; further ones are refused.
const WAITING_MAX: usize = 16;
/// A request that waited longer is refused: its sender may have given up.
const WAIT_MAX: Duration = Duration::from_secs(2);
/// Longest wait for the cell's answer. A tare averages and checks for some seconds.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest wait for the cell's answer to a stop.
const STOP_PATIENCE: Duration = Duration::from_secs(3);
/// Requests whose numbers are remembered, so that none is carried out twice.
const REMEMBERED: usize = 256;

const TRIGGER: &str = "std_srvs/srv/Trigger";
const START: &str = "tangent_msgs/srv/StartTask";
const SELECT: &str = "tangent_msgs/srv/SelectEstimator";

/// Request of `tangent_msgs/srv/StartTask`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StartTaskRequest {
    /// The task as TOML.
    pub task: String,
    /// Whether a person has checked that the tool hangs free.
    pub clear: bool,
}

/// Request of `tangent_msgs/srv/SelectEstimator`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SelectEstimatorRequest {
    /// Name of the estimator.
    pub estimator: String,
    /// Whether it is selected although its normal is far from the one in use.
    pub force: bool,
}

/// Response of `std_srvs/srv/Trigger`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// Whether it was done.
    pub success: bool,
    /// Text for an operator.
    pub message: String,
}

/// Name and type of a command's service.
fn service(command: Ros2Command) -> (&'static str, &'static str) {
    match command {
        Ros2Command::Stop => ("stop", TRIGGER),
        Ros2Command::Pause => ("pause", TRIGGER),
        Ros2Command::Status => ("status", TRIGGER),
        Ros2Command::Resume => ("resume", TRIGGER),
        Ros2Command::Start => ("start", START),
        Ros2Command::Select => ("select", SELECT),
        Ros2Command::Tare => ("tare", TRIGGER),
    }
}

/// The cell's request for a command, and its key; or what is wrong with the payload.
fn request_of(command: Ros2Command, payload: &[u8]) -> Result<(&'static str, Request), String> {
    let bad = |error: cdr::CdrError| format!("the request cannot be read: {error}");
    let (key, action, argument) = match command {
        Ros2Command::Start => {
            let start: StartTaskRequest = cdr::decode(payload).map_err(bad)?;
            let action = if start.clear { "start_clear" } else { "start" };
            (queries::CONTROL_TASK, action, start.task)
        }
        Ros2Command::Select => {
            let select: SelectEstimatorRequest = cdr::decode(payload).map_err(bad)?;
            let action = if select.force { "force" } else { "select" };
            (queries::CONTROL_SELECT, action, select.estimator)
        }
        simple => {
            empty(payload)?;
            let (key, action) = match simple {
                Ros2Command::Stop => (queries::CONTROL_STOP, "stop"),
                Ros2Command::Pause => (queries::CONTROL_TASK, "pause"),
                Ros2Command::Resume => (queries::CONTROL_TASK, "resume"),
                Ros2Command::Tare => (queries::NETFT_TARE, "tare"),
                _ => (queries::CONTROL_TASK, "status"),
            };
            (key, action, String::new())
        }
    };
    let request = Request {
        action: action.into(),
        argument,
    };
    Ok((key, request))
}

/// A request without members has one unused byte, which some programs leave out and others pad.
fn empty(payload: &[u8]) -> Result<(), String> {
    match payload.strip_prefix(&cdr::HEADER) {
        Some(rest) if rest.len() <= 4 => Ok(()),
        _ => Err(format!(
            "the request cannot be read: {} bytes are not a request without members",
            payload.len()
        )),
    }
}

/// Bytes of the response with this answer.
fn response(command: Ros2Command, answer: Answer) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoded = match service(command).1 {
        TRIGGER => {
            let data = answer.data;
            let message = match command {
                Ros2Command::Status if !data.is_empty() => data,
                _ => answer.message,
            };
            let response = TriggerResponse {
                success: answer.done,
                message,
            };
            cdr::encode(&response, &mut bytes)
        }
        _ => cdr::encode(&answer, &mut bytes),
    };
    if let Err(error) = encoded {
        tracing::error!("an answer cannot be written: {error}");
    }
    bytes
}

fn refused(reason: impl Into<String>) -> Answer {
    Answer {
        done: false,
        message: reason.into(),
        data: String::new(),
    }
}

/// A request on its way to the cell.
struct Job {
    command: Ros2Command,
    query: PlainQuery,
}

/// The services that are offered, until this is dropped.
pub struct Commands {
    _services: Vec<Endpoint>,
}

/// Requests that were taken, by client and number.
#[derive(Default)]
struct Taken(VecDeque<([u8; 16], u64)>);

impl Taken {
    /// Whether the request is new; from now on it is not.
    fn is_new(&mut self, from: Attachment) -> bool {
        let id = (from.publisher, from.sequence);
        if self.0.contains(&id) {
            return false;
        }
        if self.0.len() >= REMEMBERED {
            self.0.pop_front();
        }
        self.0.push_back(id);
        true
    }
}

impl Commands {
    /// Offers `commands` as services under `/PREFIX/`.
    ///
    /// # Errors
    /// The session is closed, or a thread cannot be started.
    pub fn open(
        commands: &[Ros2Command],
        prefix: &str,
        bus: &Bus,
        node: &Node,
        troubles: &Troubles,
        health: &HealthReporter,
    ) -> Result<Self, Ros2Error> {
        let desk = Desk {
            bus: bus.clone(),
            troubles: troubles.clone(),
            requests: health.rate("requests"),
        };
        let stop = lane("ros2-stop", desk.clone())?;
        let others = lane("ros2-command", desk)?;
        let mut services = Vec::new();
        for &command in commands {
            let (name, type_name) = service(command);
            let hash = type_hash::of_service(type_name);
            let of = hash.and_then(|hash| RosType::new(type_name, hash));
            let of =
                of.expect("the definitions of all services ship, and a test computes their hashes");
            let lane = match command {
                Ros2Command::Stop => stop.clone(),
                _ => others.clone(),
            };
            let taken = Arc::new(Mutex::new(Taken::default()));
            let troubles = troubles.clone();
            let full_name = format!("/{prefix}/{name}");
            let named = full_name.clone();
            let endpoint = node.service(&full_name, &of, move |query| {
                let mut taken = taken.lock().unwrap_or_else(PoisonError::into_inner);
                let is_new = query.attachment.map(|from| taken.is_new(from));
                drop(taken);
                let refusal = match is_new {
                    Some(true) => return hand_over(&lane, Job { command, query }),
                    // The answer to the first of the two is on its way.
                    Some(false) => "a request arrived twice, and is not carried out again",
                    None => "a request without a number and a sender is refused",
                };
                troubles.event(&named, format!("{named}: {refusal}"));
                answer(command, query, refused(refusal));
            })?;
            services.push(endpoint);
        }
        Ok(Self {
            _services: services,
        })
    }
}

/// Sends a job to its lane, or refuses it.
fn hand_over(lane: &SyncSender<Job>, job: Job) {
    let (job, why) = match lane.try_send(job) {
        Ok(()) => return,
        Err(TrySendError::Full(job)) => (job, "too many requests wait: nothing was done"),
        Err(TrySendError::Disconnected(job)) => (job, "the service is stopping: nothing was done"),
    };
    answer(job.command, job.query, refused(why));
}

/// Sends the response, with the number and the sender of the request.
fn answer(command: Ros2Command, query: PlainQuery, answer: Answer) {
    let attachment = Attachment {
        source_time_ns: clock::now_ns(),
        ..query.attachment.unwrap_or_default()
    };
    query.reply(&response(command, answer), attachment);
}

/// Starts the thread of a lane; it ends with its last sender.
fn lane(name: &str, desk: Desk) -> Result<SyncSender<Job>, Ros2Error> {
    let (sender, jobs): (_, Receiver<Job>) = sync_channel(WAITING_MAX);
    std::thread::Builder::new()
        .name(name.into())
        .spawn(move || {
            while let Ok(job) = jobs.recv() {
                desk.carry_out(job);
            }
        })?;
    Ok(sender)
}

/// Passes requests to the cell.
#[derive(Clone)]
struct Desk {
    bus: Bus,
    troubles: Troubles,
    requests: Rate,
}

impl Desk {
    fn carry_out(&self, job: Job) {
        let Job { command, query } = job;
        self.requests.tick();
        let outcome = self.outcome(command, &query.payload, query.received);
        let name = service(command).0;
        if !outcome.done {
            self.troubles
                .event(name, format!("{name}: {}", outcome.message));
        }
        tracing::info!("{name}: done: {}, {}", outcome.done, outcome.message);
        answer(command, query, outcome);
    }

    fn outcome(&self, command: Ros2Command, payload: &[u8], received: Instant) -> Answer {
        let (key, request) = match request_of(command, payload) {
            Ok(asked) => asked,
            Err(why) => return refused(why),
        };
        // A stop is never too old.
        if command != Ros2Command::Stop && received.elapsed() > WAIT_MAX {
            return refused("the request waited too long: nothing was done, send it again");
        }
        let patience = match command {
            Ros2Command::Stop => STOP_PATIENCE,
            _ => PATIENCE,
        };
        match self.bus.ask(key, &request, patience) {
            Ok(answer) => answer,
            // Both say that the outcome is unknown, and how to find out.
            Err(error @ (BusError::NoAnswer { .. } | BusError::Unknown { .. })) => {
                refused(error.to_string())
            }
            Err(error) => refused(format!("the outcome is unknown: {error}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes<T: Serialize>(value: &T) -> Vec<u8> {
        let mut bytes = Vec::new();
        cdr::encode(value, &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn requests_become_those_of_the_cell() {
        let start = StartTaskRequest {
            task: "force_n = 3.0".into(),
            clear: true,
        };
        let (key, request) = request_of(Ros2Command::Start, &bytes(&start)).unwrap();
        assert_eq!(
            (key, request.action.as_str()),
            ("control/task", "start_clear")
        );
        assert_eq!(request.argument, "force_n = 3.0");
        let (key, request) = request_of(Ros2Command::Stop, &[0, 1, 0, 0, 0]).unwrap();
        assert_eq!((key, request.action.as_str()), ("control/stop", "stop"));
    }

    #[test]
    fn a_damaged_request_is_refused_whatever_is_missing() {
        let whole = bytes(&SelectEstimatorRequest {
            estimator: "blend".into(),
            force: false,
        });
        for length in 0..whole.len() {
            let error = request_of(Ros2Command::Select, &whole[..length]).unwrap_err();
            assert!(error.contains("cannot be read"), "{error}");
        }
        for payload in [
            &[][..],
            &[0, 1],
            &[0, 0, 0, 0, 0],
            &[0, 1, 0, 0, 1, 2, 3, 4, 5],
        ] {
            assert!(
                request_of(Ros2Command::Stop, payload).is_err(),
                "{payload:?}"
            );
        }
    }

    proptest::proptest! {
        /// Bytes of a stranger become a request of the cell only if they are one.
        #[test]
        fn any_bytes_are_a_request_or_are_refused(bytes in proptest::collection::vec(0_u8.., 0..64)) {
            for command in [Ros2Command::Start, Ros2Command::Select, Ros2Command::Stop] {
                if let Ok((key, _)) = request_of(command, &bytes) {
                    proptest::prop_assert!(key.starts_with("control/"));
                    proptest::prop_assert_eq!(&bytes[..4], cdr::HEADER);
                }
            }
        }
    }

    #[test]
    fn a_request_is_new_once() {
        let mut taken = Taken::default();
        let from = |sequence| Attachment {
            sequence,
            ..Attachment::default()
        };
        assert!(taken.is_new(from(1)) && !taken.is_new(from(1)) && taken.is_new(from(2)));
        for sequence in 3..1000 {
            assert!(taken.is_new(from(sequence)));
        }
        assert_eq!(taken.0.len(), REMEMBERED);
    }

    #[test]
    fn a_status_has_its_data_in_the_message() {
        let answer = Answer {
            done: true,
            message: "sliding".into(),
            data: "{\"phase\":3}".into(),
        };
        let read = |command, answer| -> TriggerResponse {
            cdr::decode(&response(command, answer)).unwrap()
        };
        assert_eq!(
            read(Ros2Command::Status, answer.clone()).message,
            "{\"phase\":3}"
        );
        assert_eq!(read(Ros2Command::Pause, answer).message, "sliding");
    }
}
