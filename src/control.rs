//! `tangent task`, `tare`, `param`: requests to a running cell.

use std::fmt;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use serde_json::{Value, json};
use tangent_client::session::{self, ANSWER_PATIENCE, data};
use tangent_control::{Phase, Task};
use tangent_follow::{Start, start_when_ready};
use tangent_runtime::parameters::ParameterInfo;
use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::queries;

use crate::cell::{self, ask_and_print};
use crate::cli::{ParamCommand, TaskCommand};
use crate::live_view;
use crate::output::{Outcome, bad_usage, print_json};

/// Time for which `task start --follow` waits for a cell that is not ready, s, unless given.
const FOLLOW_WAIT_S: f64 = 3.0;

/// Reads the text of a task file. An error in it is reported here, with the file's name, before any
/// request to the cell.
///
/// # Errors
/// The file cannot be read or is not a task: exit code 2.
pub fn task_text(file: &Path) -> Result<String> {
    let bad = |e: &dyn fmt::Display| bad_usage(format!("task file {}: {e}", file.display()));
    let text = fs::read_to_string(file).map_err(|e| bad(&e))?;
    let _: Task = text.parse().map_err(|e| bad(&e))?;
    Ok(text)
}

/// Runs one of the task commands.
///
/// # Errors
/// The task file is invalid, or the cell does not answer.
pub fn task(command: &TaskCommand, config: &CellConfig, json: bool) -> Result<Outcome> {
    let (key, action, argument) = match command {
        TaskCommand::Start {
            file,
            wait_s,
            follow,
            clear,
        } => {
            let text = task_text(file)?;
            let start = if *clear { "start_clear" } else { "start" };
            if *follow || wait_s.is_some() {
                let wait_s = wait_s.unwrap_or(FOLLOW_WAIT_S);
                return start_within(start, &text, wait_s, *follow, config, json);
            }
            (queries::CONTROL_TASK, start, text)
        }
        TaskCommand::Pause => (queries::CONTROL_TASK, "pause", String::new()),
        TaskCommand::Resume => (queries::CONTROL_TASK, "resume", String::new()),
        TaskCommand::Stop => (queries::CONTROL_STOP, "stop", String::new()),
        TaskCommand::Status => (queries::CONTROL_TASK, "status", String::new()),
    };
    ask_and_print(&session::join(config)?, key, action, &argument, json)
}

/// Starts a task as soon as the cell is ready, and with `to_its_end` waits for that.
fn start_within(
    action: &str,
    task: &str,
    wait_s: f64,
    to_its_end: bool,
    config: &CellConfig,
    json: bool,
) -> Result<Outcome> {
    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    let began = Instant::now();
    let patience = Duration::from_secs_f64(wait_s);
    let bus = session::join_within(config, patience.max(session::ROUTER_PATIENCE), &stop)?;
    let start = Start {
        action,
        task,
        patience: patience.saturating_sub(began.elapsed()),
    };
    if !to_its_end {
        let message = start_when_ready(&bus, &start, &stop, &mut live_view::waiting)?;
        let answer = Answer {
            done: true,
            message,
            ..Answer::default()
        };
        cell::print_answer(&answer, json)?;
        return Ok(Outcome::Done);
    }
    let ended = live_view::follow(&bus, &start, &stop, false)?;
    if json {
        print_json(&json!({ "phase": ended.phase.name(), "fault": ended.fault }))?;
    }
    Ok(match ended.phase {
        Phase::Done => Outcome::Done,
        _ => Outcome::Failed,
    })
}

/// Sets the force sensor's zero. With `clear`, a person has checked that the tool hangs free.
///
/// # Errors
/// The cell does not answer.
pub fn tare(clear: bool, config: &CellConfig, json: bool) -> Result<Outcome> {
    let argument = if clear { "clear" } else { "" };
    let bus = session::join(config)?;
    ask_and_print(&bus, queries::NETFT_TARE, "tare", argument, json)
}

/// Reads or sets live parameters.
///
/// # Errors
/// The name is unknown, or the cell does not answer.
pub fn param(command: &ParamCommand, config: &CellConfig, json: bool) -> Result<Outcome> {
    match command {
        ParamCommand::Set { name, value } => {
            let (service, parameter) = split(name)?;
            let key = queries::parameter(service, parameter);
            ask_and_print(&session::join(config)?, &key, "set", value, json)
        }
        ParamCommand::Get { name: Some(name) } if name.contains('/') => {
            let (service, parameter) = split(name)?;
            let key = queries::parameter(service, parameter);
            ask_and_print(&session::join(config)?, &key, "get", "", json)
        }
        ParamCommand::Get { name } => {
            let key = queries::parameters(name.as_deref().unwrap_or("*"));
            list(&session::join(config)?, &key, json)
        }
    }
}

fn split(name: &str) -> Result<(&str, &str)> {
    name.split_once('/').ok_or_else(|| {
        bad_usage(format!(
            "parameter \"{name}\": write SERVICE/NAME; `tangent param get` lists them all"
        ))
    })
}

fn list(bus: &Bus, key: &str, json: bool) -> Result<Outcome> {
    let request = Request {
        action: "list".to_owned(),
        argument: String::new(),
    };
    let answers = bus.ask_all(key, &request, ANSWER_PATIENCE)?;
    if answers.is_empty() {
        anyhow::bail!("no service answers {key}; `tangent status` lists the services");
    }
    if json {
        let all: serde_json::Map<String, Value> = answers
            .iter()
            .map(|(key, answer)| (key.clone(), data(answer)))
            .collect();
        print_json(&json!({ "parameters": all }))?;
    } else {
        for parameter in answers
            .iter()
            .filter_map(|(_, a)| serde_json::from_str::<Vec<ParameterInfo>>(&a.data).ok())
            .flatten()
        {
            println!(
                "{:<44} {:>10} {:<6} {} to {}  {}",
                format!("{}/{}", parameter.service, parameter.name),
                parameter.value,
                parameter.unit,
                parameter.minimum,
                parameter.maximum,
                parameter.description
            );
        }
    }
    Ok(Outcome::Done)
}
