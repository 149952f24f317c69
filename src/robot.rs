//! `tangent robot`: requests changes of the robot's modes from its bridge over the bus. Each
//! command prints the robot's answer, then waits until the arm is in the requested state, or prints
//! why it is not.

use std::time::{Duration, Instant};

use anyhow::Result;
use serde_json::{Value, json};
use tangent_client::session::{self, data};
use tangent_runtime::config::RobotDriver;
use tangent_runtime::{Bus, CellConfig, Latest};
use tangent_schemas::tangent::{Answer, ArmState};
use tangent_schemas::topics;

use crate::cell;
use crate::cli::RobotCommand;
use crate::output::{Outcome, print_json};

/// Largest age at which the arm's state counts as current.
const FRESH: Duration = Duration::from_millis(500);
/// Timeout of the bridge's first packet.
const FIRST_STATE: Duration = Duration::from_secs(3);
/// Interval between two checks of the arm's state.
const LOOK: Duration = Duration::from_millis(50);
/// Time for which the arm must stay ready: a mode that is left at once does not count.
const STEADY: Duration = Duration::from_millis(300);
/// Longest time until the power is off.
const POWER_OFF_WAIT: Duration = Duration::from_secs(10);

/// Runs one of the robot commands.
///
/// # Errors
/// The cell cannot be reached, or its bridge does not answer.
pub fn run(command: &RobotCommand, config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = session::join(config)?;
    let mut arm = bus.latest(&topics::ARM_STATE)?;
    let franka = config.robot.driver == RobotDriver::Franka;
    let service = if franka { "franka" } else { "rtde" };
    let (action, wait) = match command {
        RobotCommand::Unlock { wait_s } => ("unlock", Wait::Ready(*wait_s)),
        RobotCommand::Reset { wait_s } => ("reset", Wait::Ready(*wait_s)),
        RobotCommand::PowerOn { wait_s } => ("power_on", Wait::Ready(*wait_s)),
        RobotCommand::PowerOff => ("power_off", Wait::Off),
        RobotCommand::Status => return status(&bus, service, &mut arm, json),
    };
    let answer = session::ask(&bus, &format!("{service}/{action}"), action, "")?;
    if !answer.done {
        cell::print_answer(&answer, json)?;
        return Ok(Outcome::Failed);
    }
    if !json {
        cell::print_answer(&answer, false)?;
    }
    let (reached, words) = wait.watch(&mut arm);
    if json {
        print_json(&json!({
            "done": reached,
            "message": words,
            "robot": answer.message,
            "data": data(&answer),
        }))?;
    } else {
        println!("{words}");
    }
    Ok(if reached {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}

/// The state of the arm to wait for after a request.
enum Wait {
    /// Ready to move, within this many seconds.
    Ready(f64),
    /// Without power.
    Off,
}

impl Wait {
    /// Waits for the state. Returns whether it was reached, and the arm's state as text.
    fn watch(&self, arm: &mut Latest<ArmState>) -> (bool, String) {
        let patience = match self {
            Self::Ready(wait_s) => Duration::from_secs_f64(*wait_s),
            Self::Off => POWER_OFF_WAIT,
        };
        let until = Instant::now() + patience;
        let mut since: Option<Instant> = None;
        loop {
            let state = arm.fresh(FRESH).map(|received| &received.message);
            let reached = match (self, state) {
                (Self::Ready(_), Some(state)) => state.ready,
                (Self::Off, Some(state)) => !state.ready,
                (_, None) => false,
            };
            if reached {
                let began = *since.get_or_insert_with(Instant::now);
                if began.elapsed() >= STEADY {
                    return (true, self.reached(state));
                }
            } else {
                since = None;
            }
            if Instant::now() >= until {
                return (false, not_reached(state, patience));
            }
            std::thread::sleep(LOOK);
        }
    }

    fn reached(&self, state: Option<&ArmState>) -> String {
        match self {
            Self::Ready(_) => "the arm is ready: start a task to move it".to_owned(),
            Self::Off => format!("the arm does not move: {}", reason(state)),
        }
    }
}

fn not_reached(state: Option<&ArmState>, patience: Duration) -> String {
    format!(
        "not ready within {:.0} s: {}",
        patience.as_secs_f64(),
        reason(state)
    )
}

fn reason(state: Option<&ArmState>) -> String {
    match state {
        None => "no arm/state received: is the bridge connected to the robot?".to_owned(),
        Some(state) if state.ready => "the arm is ready".to_owned(),
        Some(state) => state.not_ready_reason.to_string(),
    }
}

/// Prints the bridge's answer, with the newest `arm/state`.
fn status(bus: &Bus, service: &str, arm: &mut Latest<ArmState>, json: bool) -> Result<Outcome> {
    let answer = session::ask(bus, &format!("{service}/status"), "status", "")?;
    let until = Instant::now() + FIRST_STATE;
    while arm.fresh(FRESH).is_none() && Instant::now() < until {
        std::thread::sleep(LOOK);
    }
    let state = arm.fresh(FRESH).map(|received| &received.message);
    let mut fields = match data(&answer) {
        Value::Object(fields) => fields,
        _ => serde_json::Map::new(),
    };
    fields.insert("ready".to_owned(), state.is_some_and(|s| s.ready).into());
    fields.insert("reason".to_owned(), reason(state).into());
    if let Some(state) = state {
        fields.insert(
            "commanded_by".to_owned(),
            state.commanded_by.as_str().into(),
        );
        fields.insert("speed_scaling".to_owned(), state.speed_scaling.into());
        fields.insert("joints_rad".to_owned(), json!(state.q.as_slice()));
    }
    let shown = Answer {
        data: Value::Object(fields).to_string(),
        ..answer
    };
    cell::print_answer(&shown, json)?;
    Ok(if shown.done {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}
