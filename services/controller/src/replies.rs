//! Texts of the answers to requests.

use serde_json::json;
use tangent_control::{EstimatorName, Phase};
use tangent_runtime::bus::answer::{done_with, refused};
use tangent_schemas::tangent::Answer;

use crate::mailbox::{Outcome, Silence};

/// Text for an outcome; `name` is the estimator of a switch.
pub fn told(
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

/// Effect of a stop, by the phase after the request was received.
pub fn stopped(phase: Phase) -> &'static str {
    match phase {
        Phase::Idle | Phase::Done | Phase::Fault => {
            "no task runs, and the tool has left the surface or never touched it: nothing to do"
        }
        Phase::Tare => "ended before the approach: nothing has moved",
        _ => "retracting",
    }
}

/// Effect of a pause in each phase.
pub fn paused(phase: Phase) -> &'static str {
    match phase {
        Phase::Tare => "paused before the approach: the arm is at rest",
        Phase::Approach => "paused in the approach: the arm is at rest, not pressing",
        Phase::Seek => "paused without contact: the arm is at rest, not seeking the surface",
        Phase::Lift => "paused above the surface: the arm is at rest, between two strokes",
        Phase::Contact => "paused after the touch: pressing, not sliding",
        _ => "paused: pressing, not sliding",
    }
}

/// Why the loop did not answer, as text.
pub fn silence_text(silence: Silence) -> &'static str {
    match silence {
        Silence::Withdrawn => NO_LOOP,
        Silence::Full => "too many requests at once: nothing was done, send it again",
        Silence::Lost => {
            "the loop ended before it completed the request: the controller has to be started again"
        }
    }
}

pub const TOO_LATE: &str = "the loop reached the request too late: nothing was done, send it again";
pub const MAY_TOUCH: &str = "no task runs, and the tool may touch something: nothing was done";
/// A stop after a restart, with the tool possibly still pressing.
pub const LEAVING: &str = "no task runs, but the tool may still touch what it touched before the controller started: \
    moving off along the last known normal";
pub const STOPPED: &str = "a stop was requested after this start, or the controller is ending: nothing was started, start again";

/// No cycle of the loop: the present state is unknown.
pub const NO_STATE: &str = "the loop does not run: no arm/state is received; is the bridge (rtde or franka) running, and \
    is the robot reachable?";
/// The loop does not run, because no state of the arm arrives.
pub const NO_LOOP: &str = "the loop does not run: no arm/state is received; nothing was done; is the bridge (rtde or \
    franka) running, and is the robot reachable?";
