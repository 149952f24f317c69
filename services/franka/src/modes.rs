//! Requests that change or report the robot's modes, with the same names as for every arm:
//! `franka/unlock`, `franka/reset`, `franka/power_on`, `franka/power_off`, `franka/status`.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::json;
use tangent_runtime::bus::answer::{done_with, refused};
use tangent_runtime::{Bus, BusError, Handle, Latest};
use tangent_schemas::tangent::{Answer, ArmState, Request};
use tangent_schemas::topics;

use crate::queries;

/// Age beyond which `arm/state` does not show the present state of the robot.
const FRESH: Duration = Duration::from_millis(500);
/// Timeout of the bridge's own answer.
const ANSWER: Duration = Duration::from_secs(1);
/// `ArmState.safety_mode` of a reflex.
const REFLEX: i32 = 3;
const POWER: &str = "a Franka's control interface has no command for power and brakes: use its web page (Desk), and \
    switch FCI on there";
const GUIDE: &str = "a Franka is guided with its own buttons: hold both buttons at the hand and move the arm. Its \
    poses are read all the same";

/// Starts to answer requests.
pub(crate) fn answers(bus: &Bus) -> Result<Vec<Handle>, BusError> {
    let modes = Arc::new(Modes {
        bus: bus.clone(),
        arm: Mutex::new(bus.latest(&topics::ARM_STATE)?),
    });
    type Asked = fn(&Modes) -> Answer;
    let requests: [(&str, Asked); 6] = [
        (queries::UNLOCK, Modes::unlock),
        (queries::RESET, Modes::unlock),
        (queries::POWER_ON, |_| refused(POWER)),
        (queries::POWER_OFF, |_| refused(POWER)),
        (queries::GUIDE, |_| refused(GUIDE)),
        (queries::STATUS, Modes::status),
    ];
    requests
        .into_iter()
        .map(|(key, request)| {
            let modes = Arc::clone(&modes);
            bus.answer(key, move |_, _| request(&modes))
        })
        .collect()
}

struct Modes {
    bus: Bus,
    arm: Mutex<Latest<ArmState>>,
}

impl Modes {
    /// Value from the robot's newest packet; `None` if no packets arrive.
    fn arm<T>(&self, of: impl FnOnce(&ArmState) -> T) -> Option<T> {
        let mut arm = self.arm.lock().unwrap_or_else(PoisonError::into_inner);
        arm.fresh(FRESH).map(|received| of(&received.message))
    }

    /// Leaves a reflex. While a task runs there is no reflex, so no task is interrupted.
    fn unlock(&self) -> Answer {
        let Some((safety, ready, reason)) =
            self.arm(|arm| (arm.safety_mode, arm.ready, arm.not_ready_reason))
        else {
            return refused(
                "no state from the robot: is it on, and FCI switched on in its web page?",
            );
        };
        if safety != REFLEX {
            let now = if ready {
                "the arm is ready"
            } else {
                reason.as_str()
            };
            return refused(format!("there is no reflex to leave: {now}"));
        }
        let request = Request {
            action: "recover".to_owned(),
            argument: String::new(),
        };
        match self.bus.ask(queries::RECOVER, &request, ANSWER) {
            Ok(answer) => answer,
            Err(error) => refused(error.to_string()),
        }
    }

    fn status(&self) -> Answer {
        let said = self.arm(|arm| {
            let safety = match arm.safety_mode {
                1 => "normal",
                REFLEX => "reflex",
                5 => "user stop",
                _ => "unknown",
            };
            let ready = if arm.ready {
                "the arm is ready"
            } else {
                arm.not_ready_reason.as_str()
            };
            let words = format!("safety is {safety}; {ready}");
            (
                words,
                json!({ "safety_mode": arm.safety_mode, "robot_mode": arm.robot_mode }),
            )
        });
        match said {
            Some((words, numbers)) => done_with(words, &numbers),
            None => {
                refused("no state from the robot: is it on, and FCI switched on in its web page?")
            }
        }
    }
}
