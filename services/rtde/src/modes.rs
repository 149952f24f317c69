//! Requests that change or report the robot's modes: `rtde/unlock`, `rtde/reset`, `rtde/power_on`,
//! `rtde/power_off`, `rtde/status`, `rtde/stop`. Each returns the robot's answer. A request that
//! would take the arm from a running task is refused.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::json;
use tangent_runtime::bus::answer::{done, done_with, refused};
use tangent_runtime::{Bus, BusError, Handle, Lane, Latest, Reply};
use tangent_schemas::arm_modes::{PROTECTIVE_STOP, ROBOT_RUNNING};
use tangent_schemas::tangent::{Answer, ArmState};
use tangent_schemas::topics;

use crate::dashboard::{Dashboard, DashboardError};
use crate::program::ProgramState;
use crate::queries;
use crate::robot_setup;
use crate::settings::Config;
use crate::shared::Shared;
use crate::status::{robot_mode_text, runtime_state_text, safety_mode_text};

/// Age beyond which `arm/state` does not show the present state of the robot.
const FRESH: Duration = Duration::from_millis(500);
/// Reason for refusing a request while a task runs.
const TASK_RUNS: &str = "a task uses the arm: stop it first with `tangent task stop`";

/// Starts to answer requests.
pub(crate) fn answers(
    config: &Arc<Config>,
    bus: &Bus,
    shared: &Arc<Shared>,
) -> Result<Vec<Handle>, BusError> {
    let modes = Arc::new(Modes {
        config: Arc::clone(config),
        shared: Arc::clone(shared),
        arm: Mutex::new(bus.latest(&topics::ARM_STATE)?),
    });
    // The dashboard may be slow; a stop must not wait for it.
    type Request = fn(&Modes) -> Reply;
    let requests: [(&str, Lane, Request); 6] = [
        (queries::RESET, Lane::Prompt, |modes| modes.reset().into()),
        (queries::STOP, Lane::Urgent, |modes| modes.stop().into()),
        (queries::POWER_ON, Lane::Slow, Modes::power_on),
        (queries::UNLOCK, Lane::Slow, Modes::unlock),
        (queries::POWER_OFF, Lane::Slow, Modes::power_off),
        (queries::STATUS, Lane::Slow, |modes| modes.status().into()),
    ];
    requests
        .into_iter()
        .map(|(key, lane, request)| {
            let modes = Arc::clone(&modes);
            bus.answer_in(key, move |_| lane, move |_| request(&modes))
        })
        .collect()
}

struct Modes {
    config: Arc<Config>,
    shared: Arc<Shared>,
    arm: Mutex<Latest<ArmState>>,
}

impl Modes {
    /// Value from the robot's newest packet; `None` if no packets arrive.
    fn arm<T>(&self, of: impl FnOnce(&ArmState) -> T) -> Option<T> {
        let mut arm = self.arm.lock().unwrap_or_else(PoisonError::into_inner);
        arm.fresh(FRESH).map(|received| of(&received.message))
    }

    /// Whether the bridge's program streams velocities to the arm, which it does only for a task.
    fn task_runs(&self) -> bool {
        let streams = |arm: &ArmState| arm.program_state == ProgramState::Streaming.number();
        self.arm(streams).unwrap_or(false)
    }

    fn reset(&self) -> Answer {
        if self.task_runs() {
            return refused(TASK_RUNS);
        }
        self.shared.reset_asked.store(true, Ordering::Release);
        done("the robot program is sent again if needed; start a task to move")
    }

    fn stop(&self) -> Answer {
        self.shared.stop_asked.store(true, Ordering::Release);
        done("stopping; start a task to move again")
    }

    fn unlock(&self) -> Reply {
        if let Some(mode) = self.arm(|arm| arm.safety_mode)
            && mode != PROTECTIVE_STOP
        {
            return refused(format!(
                "there is no protective stop to leave: safety is {}",
                safety_mode_text(mode)
            ))
            .into();
        }
        self.on_dashboard(Dashboard::unlock_protective_stop)
    }

    fn power_on(&self) -> Reply {
        if self.arm(|arm| arm.robot_mode) == Some(ROBOT_RUNNING) {
            return done("the arm is already powered and its brakes are open").into();
        }
        let reply = self.on_dashboard(|robot| match robot.robot_mode()?.as_str() {
            "POWER_OFF" => robot.power_on(),
            mode => Ok(format!("robot mode {mode}")),
        });
        let Reply::Answered(answer) = reply else {
            return reply;
        };
        if !answer.done {
            return answer.into();
        }
        // The brakes can be released once power is there, which takes a while.
        self.shared.power_on_asked.store(true, Ordering::Release);
        self.shared.wake_setup();
        done(format!(
            "{}; then the brakes are released; arm/state reports when the arm is ready",
            answer.message
        ))
        .into()
    }

    fn power_off(&self) -> Reply {
        if self.task_runs() {
            return refused(TASK_RUNS).into();
        }
        self.on_dashboard(Dashboard::power_off)
    }

    /// Sends a command to the dashboard server. One without an answer may have been carried out.
    fn on_dashboard(
        &self,
        command: impl FnOnce(&mut Dashboard) -> Result<String, DashboardError>,
    ) -> Reply {
        let mut dashboard = match robot_setup::dashboard(&self.config) {
            Ok(dashboard) => dashboard,
            Err(error) => return refused(error.to_string()).into(),
        };
        match command(&mut dashboard) {
            Ok(reply) => done(reply).into(),
            Err(error @ DashboardError::Refused { .. }) => refused(error.to_string()).into(),
            Err(error) => Reply::Unknown(format!("{error}; check the pendant")),
        }
    }

    fn status(&self) -> Answer {
        let asked = robot_setup::dashboard(&self.config).and_then(|mut robot| {
            Ok(json!({
                "robot_mode": robot.robot_mode()?,
                "model": robot.robot_model()?,
                "polyscope": robot.polyscope_version()?,
                "remote_control": robot.is_in_remote_control()?,
            }))
        });
        let dashboard = asked.unwrap_or_else(|error| json!({ "error": error.to_string() }));
        let said = self.arm(|arm| {
            let words = format!(
                "robot is {}, safety is {}, program is {}",
                robot_mode_text(arm.robot_mode),
                safety_mode_text(arm.safety_mode),
                runtime_state_text(arm.runtime_state)
            );
            let numbers = json!({
                "robot_mode": arm.robot_mode,
                "safety_mode": arm.safety_mode,
                "runtime_state": arm.runtime_state,
                "dashboard": dashboard,
            });
            (words, numbers)
        });
        match said {
            Some((words, numbers)) => done_with(words, &numbers),
            None => Answer {
                data: json!({ "dashboard": dashboard }).to_string(),
                ..refused(format!(
                    "no packet from the robot; its dashboard reports {dashboard}"
                ))
            },
        }
    }
}
