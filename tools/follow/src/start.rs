//! Starts a task as soon as the cell is ready.

use std::error::Error;
use std::iter::successors;
use std::time::{Duration, Instant};

use tangent_client::ClientError;
use tangent_client::session::{ask, data};
use tangent_control::preflight::REFUSED;
use tangent_control::{Phase, Task};
use tangent_runtime::{Bus, Latest, Stop};
use tangent_schemas::tangent::{ArmState, WrenchStatus};
use tangent_schemas::topics::{self, queries};

use crate::error::FollowError;

/// Interval between two checks of robot and sensor.
const LOOK: Duration = Duration::from_millis(50);
/// Interval between two attempts to start a task that is refused because the cell is not ready.
const RETRY: Duration = Duration::from_millis(500);

/// A task that is to be started.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// Request to the controller: `start`, or `start_clear` if an operator has checked that the
    /// tool is free.
    pub action: &'a str,
    /// The task, TOML.
    pub task: &'a str,
    /// Longest wait for a cell that is not ready.
    pub patience: Duration,
}

/// Starts the task as soon as the cell is ready, and returns the controller's message. `waiting` is
/// called with the reason while the task cannot be started yet.
///
/// # Errors
/// The cell is not ready, or refuses the task, for longer than the patience; a stop is requested
/// before.
pub fn start_when_ready(
    bus: &Bus,
    start: &Start,
    stop: &Stop,
    waiting: &mut dyn FnMut(&str),
) -> Result<String, FollowError> {
    let until = Instant::now() + start.patience;
    wait_until_ready(bus, stop, until, waiting)?;
    request(bus, start, stop, until, waiting)
}

/// Requests the start until it is granted: a controller or an estimator may still be starting up.
fn request(
    bus: &Bus,
    start: &Start,
    stop: &Stop,
    until: Instant,
    waiting: &mut dyn FnMut(&str),
) -> Result<String, FollowError> {
    let mut said = String::new();
    let mut unknown = false;
    loop {
        let reason = match ask(bus, queries::CONTROL_TASK, start.action, start.task) {
            Ok(answer) if answer.done => return Ok(answer.message),
            // An answer before this one may have been lost on its way.
            Ok(_) if unknown && runs(bus, start.task) => {
                return Ok("the task runs; the answer to its start request was lost".to_owned());
            }
            Ok(answer) if answer.message.starts_with(REFUSED) => {
                return Err(FollowError::Refused(answer.message));
            }
            Ok(answer) => answer.message,
            Err(error) => {
                unknown = true;
                with_causes(&error)
            }
        };
        if Instant::now() >= until {
            return Err(FollowError::NotStarted(reason));
        }
        if reason != said {
            waiting(&reason);
            said = reason;
        }
        if stop.wait(RETRY) {
            return Err(FollowError::Stopped);
        }
    }
}

/// An error and everything that caused it, in one line.
fn with_causes(error: &ClientError) -> String {
    let error: &dyn Error = error;
    let chain = successors(Some(error), |error| (*error).source());
    let words: Vec<String> = chain.map(ToString::to_string).collect();
    words.join(": ")
}

/// Whether the controller reports that a task of this name is active.
fn runs(bus: &Bus, task: &str) -> bool {
    let (Ok(task), Ok(answer)) = (
        task.parse::<Task>(),
        ask(bus, queries::CONTROL_TASK, "status", ""),
    ) else {
        return false;
    };
    let status = data(&answer);
    let phase = |phase: Phase| status["phase"] == phase.name();
    status["task"] == task.name.as_str()
        && Phase::ALL.into_iter().any(|p| p.is_active() && phase(p))
}

fn wait_until_ready(
    bus: &Bus,
    stop: &Stop,
    until: Instant,
    waiting: &mut dyn FnMut(&str),
) -> Result<(), FollowError> {
    let mut arm: Latest<ArmState> = bus.latest(&topics::ARM_STATE)?;
    let mut sensor: Latest<WrenchStatus> = bus.latest(&topics::WRENCH_STATUS)?;
    let began = Instant::now();
    let mut said = String::new();
    loop {
        let arm_waits = match arm.get() {
            None => Some("no packet from the robot yet".to_owned()),
            Some(r) if r.message.ready => None,
            Some(r) => Some(r.message.not_ready_reason.to_string()),
        };
        let sensor_waits = match sensor.get() {
            None => Some("no record from the sensor yet".to_owned()),
            Some(r) if r.message.validity == 0 => None,
            Some(r) => Some(r.message.status_text.to_string()),
        };
        let waits: Vec<String> = arm_waits
            .map(|w| format!("robot: {w}"))
            .into_iter()
            .chain(sensor_waits.map(|w| format!("sensor: {w}")))
            .collect();
        if waits.is_empty() {
            return Ok(());
        }
        let waits = waits.join("; ");
        if waits != said {
            waiting(&waits);
            said = waits;
        }
        if Instant::now() >= until {
            return Err(FollowError::NotReady {
                waited: began.elapsed(),
                reason: said,
            });
        }
        if stop.wait(LOOK) {
            return Err(FollowError::Stopped);
        }
    }
}
