//! One task from its start to its end: starts it when the cell is ready, shows its progress, and
//! retracts on a stop.

use std::time::{Duration, Instant};

use tangent_client::session::ask;
use tangent_control::{Phase, Verdict};
use tangent_runtime::{Bus, Stop};
use tangent_schemas::topics::{self, queries};

use crate::error::FollowError;
use crate::start::{Start, start_when_ready};
use crate::view::FollowView;

/// Longest wait for the retract after a stop.
const RETRACT_PATIENCE: Duration = Duration::from_secs(20);
/// Silence after which the controller counts as ended. It is longer than the restart of a router or
/// a container.
const SILENCE: Duration = Duration::from_secs(30);
/// Interval at which the view is updated.
const LOOK: Duration = Duration::from_millis(50);

/// How a task ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Ended {
    /// Phase in which it ended.
    pub phase: Phase,
    /// Fault that ended it; empty if there was none.
    pub fault: String,
    /// Share of the path that was followed, 0 to 1.
    pub progress: f64,
}

impl Ended {
    /// Whether it is a success: a task that was stopped is none.
    pub fn verdict(&self) -> Option<Verdict> {
        Verdict::of(self.phase, self.progress)
    }
}

/// Starts the task when the cell is ready, shows its progress, and waits for its end. With `stay`,
/// it returns only when `stop` is triggered. A `stop` before the end of the task retracts the tool.
///
/// # Errors
/// The cell is not ready, or refuses the task, for longer than the patience; the arm does not
/// retract; the controller publishes nothing any more.
pub fn follow(
    bus: &Bus,
    start: &Start,
    stop: &Stop,
    stay: bool,
    view: &mut dyn FollowView,
) -> Result<Ended, FollowError> {
    let mut control = bus.latest(&topics::CONTROL_STATE)?;
    let mut truth = bus.latest(&topics::TRUTH_CONTACT)?;
    let message = start_when_ready(bus, start, stop, &mut |reason| view.waiting(reason))?;
    view.say(&message);
    let mut asked_to_stop: Option<Instant> = None;
    let (mut active, mut seen_active) = (false, false);
    let mut progress: f64 = 0.0;
    let started = Instant::now();
    let phase = loop {
        let newest = control.get();
        if let Some(newest) = newest {
            let truth = truth.get().map(|received| &received.message);
            view.show(&newest.message, newest.age(), truth);
        }
        let phase = newest.and_then(|received| Phase::from_code(received.message.phase));
        if let Some(phase) = phase {
            // Another task may follow while `stay` waits for the stop.
            if phase.is_active() && !active {
                progress = 0.0;
            }
            active = phase.is_active();
            seen_active |= active;
            progress = progress.max(newest.map_or(0.0, |newest| newest.message.path_progress));
            if seen_active && !phase.is_active() && (!stay || stop.is_stopped()) {
                break phase;
            }
        }
        let silence = newest.map_or_else(|| started.elapsed(), |received| received.age());
        if silence > SILENCE {
            return Err(FollowError::Silent(SILENCE));
        }
        if stop.is_stopped() {
            let since = *asked_to_stop.get_or_insert_with(|| {
                view.say("retracting");
                if let Err(error) = ask(bus, queries::CONTROL_STOP, "stop", "") {
                    view.say(&error.to_string());
                }
                Instant::now()
            });
            if since.elapsed() > RETRACT_PATIENCE {
                return Err(FollowError::NotRetracted(RETRACT_PATIENCE));
            }
            std::thread::sleep(LOOK);
        } else {
            stop.wait(LOOK);
        }
    };
    let mut fault = String::new();
    if let Some(newest) = control.get() {
        let truth = truth.get().map(|received| &received.message);
        view.show(&newest.message, newest.age(), truth);
        if phase == Phase::Fault {
            fault = newest.message.fault.to_string();
        }
    }
    Ok(Ended {
        phase,
        fault,
        progress,
    })
}
