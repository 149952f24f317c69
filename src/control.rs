//! `tangent task`, `tare`, `param`: requests to a running cell.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use serde_json::{Value, json};
use tangent_client::session::{self, ANSWER_PATIENCE, data};
use tangent_control::Verdict;
use tangent_follow::{Start, start_when_ready};
use tangent_mechanics::names::did_you_mean;
use tangent_runtime::parameters::ParameterInfo;
use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::queries;

use crate::cell::{self, ask_and_print};
use crate::cli::{ParamCommand, TaskCommand};
use crate::live_view;
use crate::output::{Outcome, bad_usage, print_json};
use crate::table::paragraph;
use crate::task_file::task_text;

/// Time for which `task start --follow` waits for a cell that is not ready, s, unless given.
const FOLLOW_WAIT_S: f64 = 3.0;

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
            let text = task_text(file, &[])?;
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
        print_json(&json!({
            "verdict": ended.verdict(),
            "progress": ended.progress,
            "phase": ended.phase.name(),
            "fault": ended.fault,
        }))?;
    }
    Ok(match ended.verdict() {
        Some(Verdict::Completed) => Outcome::Done,
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
            let bus = session::join(config)?;
            let key = queries::parameter(service, parameter);
            ask_and_print(&bus, &key, "set", value, json).map_err(|e| unknown(&bus, name, e))
        }
        ParamCommand::Get { name: Some(name) } if name.contains('/') => {
            let (service, parameter) = split(name)?;
            let bus = session::join(config)?;
            let key = queries::parameter(service, parameter);
            ask_and_print(&bus, &key, "get", "", json).map_err(|e| unknown(&bus, name, e))
        }
        ParamCommand::Get { name } => {
            let bus = session::join(config)?;
            let service = name.as_deref().unwrap_or("*");
            list(&bus, &queries::parameters(service), json).map_err(|e| unknown(&bus, service, e))
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

/// Adds to the error of a request that no service answers: the nearest name that exists, of a
/// parameter `SERVICE/NAME` or of a service, and all services with parameters.
fn unknown(bus: &Bus, name: &str, error: anyhow::Error) -> anyhow::Error {
    let Ok(answers) = answers(bus, &queries::parameters("*")) else {
        return error;
    };
    let parameters = infos(&answers);
    let mut services: Vec<&str> = parameters.iter().map(|p| p.service.as_str()).collect();
    services.sort_unstable();
    services.dedup();
    let service = name.split('/').next().unwrap_or_default();
    if services.is_empty() || services.contains(&service) {
        return error;
    }
    let full: Vec<String> = parameters
        .iter()
        .map(|p| format!("{}/{}", p.service, p.name))
        .collect();
    let meant = if name.contains('/') {
        did_you_mean(name, full.iter().map(String::as_str))
    } else {
        did_you_mean(name, services.iter().copied())
    };
    bad_usage(format!(
        "no service `{service}` has parameters{meant}; there are: {} (`tangent param get` lists all)",
        services.join(", ")
    ))
}

fn answers(bus: &Bus, key: &str) -> Result<Vec<(String, Answer)>> {
    let request = Request {
        action: "list".to_owned(),
        argument: String::new(),
    };
    Ok(bus.ask_all(key, &request, ANSWER_PATIENCE)?)
}

/// All parameters in the answers, sorted by service and name.
fn infos(answers: &[(String, Answer)]) -> Vec<ParameterInfo> {
    let mut all: Vec<ParameterInfo> = answers
        .iter()
        .filter_map(|(_, a)| serde_json::from_str::<Vec<ParameterInfo>>(&a.data).ok())
        .flatten()
        .collect();
    all.sort_by(|a, b| (&a.service, &a.name).cmp(&(&b.service, &b.name)));
    all
}

fn list(bus: &Bus, key: &str, json: bool) -> Result<Outcome> {
    let answers = answers(bus, key)?;
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
        for p in infos(&answers) {
            println!(
                "{}/{} = {} {} ({} to {})",
                p.service, p.name, p.value, p.unit, p.minimum, p.maximum
            );
            paragraph(4, &p.description);
        }
    }
    Ok(Outcome::Done)
}
