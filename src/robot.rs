//! `tangent robot`: the robot's own modes, asked of its bridge over the bus. Each command says what
//! the robot answered, then waits until the arm is as it was asked to be, or says why it is not.

use std::time::{Duration, Instant};

use anyhow::Result;
use serde_json::{Value, json};
use tangent_runtime::config::RobotDriver;
use tangent_runtime::{Bus, CellConfig, Latest};
use tangent_schemas::tangent::{Answer, ArmState};
use tangent_schemas::topics;

use crate::cell::{self, data};
use crate::cli::RobotCommand;
use crate::output::{Outcome, print_json};

/// Older than this, the arm's state is not what the arm does now.
const FRESH: Duration = Duration::from_millis(500);
/// How long the bridge's first packet is waited for.
const FIRST_STATE: Duration = Duration::from_secs(3);
/// Between two looks at the arm's state.
const LOOK: Duration = Duration::from_millis(50);
/// The arm stays ready for so long before it is called ready: a mode that is left again is none.
const STEADY: Duration = Duration::from_millis(300);
/// How long power may take to go.
const POWER_OFF_WAIT: Duration = Duration::from_secs(10);

/// Runs one of the robot commands.
///
/// # Errors
/// A cell that cannot be reached, or whose bridge does not answer.
pub fn run(command: &RobotCommand, config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = cell::join(config)?;
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
    let answer = cell::ask(&bus, &format!("{service}/{action}"), action, "")?;
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

/// What the arm is watched for after a request.
enum Wait {
    /// Ready to move, within so many seconds.
    Ready(f64),
    /// Not ready: without power.
    Off,
}

impl Wait {
    /// Whether it came to be, and the arm's state in words.
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
    format!("not ready within {patience:.0?}: {}", reason(state))
}

fn reason(state: Option<&ArmState>) -> String {
    match state {
        None => "no arm/state comes in: is the bridge connected to the robot?".to_owned(),
        Some(state) if state.ready => "the arm is ready".to_owned(),
        Some(state) => state.not_ready_reason.to_string(),
    }
}

/// The bridge's answer, with what `arm/state` says now.
fn status(bus: &Bus, service: &str, arm: &mut Latest<ArmState>, json: bool) -> Result<Outcome> {
    let answer = cell::ask(bus, &format!("{service}/status"), "status", "")?;
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
