//! The cell that a command works on: its file, and a session on its bus.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use serde_json::{Value, json};
use tangent_runtime::{Bus, CellConfig, Role, Stop};
use tangent_schemas::tangent::{Answer, Request};

use crate::compose;
use crate::output::{Outcome, bad_usage, print_json};

/// Time that a command waits for the cell's router.
pub const ROUTER_PATIENCE: Duration = Duration::from_secs(3);
/// Time that a command waits for a service's answer.
pub const ANSWER_PATIENCE: Duration = Duration::from_secs(5);

/// Reads the cell file that `--cell` or TANGENT_CELL names. Without one, it is the built-in
/// simulated cell.
///
/// # Errors
/// The file cannot be read, or a key is not valid: exit code 2.
pub fn load(path: Option<&Path>, identity: Option<&str>) -> Result<CellConfig> {
    let Some(path) = path else {
        return Ok(CellConfig::default_cell());
    };
    let mut config = CellConfig::load(path).map_err(bad_usage)?;
    compose::model(&config).map_err(|e| bad_usage(format!("{}: {e}", path.display())))?;
    if let Some(identity) = identity {
        config.zenoh.identify(identity);
    }
    Ok(config)
}

/// Joins the cell's network as a client.
///
/// # Errors
/// No router answers.
pub fn join(config: &CellConfig) -> Result<Bus> {
    join_within(config, ROUTER_PATIENCE, &Stop::new())
}

/// Joins the cell's network as a client. Waits for the router for at most `patience`, or until
/// `stop` is triggered.
///
/// # Errors
/// No router answers in time.
pub fn join_within(config: &CellConfig, patience: Duration, stop: &Stop) -> Result<Bus> {
    let mut config = as_operator(config);
    // A command that a person waits for needs no real-time priority.
    config.realtime.enabled = false;
    Bus::open_until(&config, Role::Client, Some(patience), stop).with_context(|| {
        format!(
            "cell {} cannot be reached; start it with `tangent up`, or `tangent run router` and its services",
            config.cell.name
        )
    })
}

/// Joins the network of all cells as a client.
///
/// # Errors
/// No router answers.
pub fn join_all(config: &CellConfig) -> Result<Bus> {
    Ok(Bus::open_network(
        &as_operator(config).zenoh,
        ROUTER_PATIENCE,
    )?)
}

/// A person at the command line is an operator, unless another identity is given.
fn as_operator(config: &CellConfig) -> CellConfig {
    let mut config = config.clone();
    config.zenoh.identify("operator");
    config
}

/// Sends a request to one service and prints the answer.
///
/// # Errors
/// No service answers.
pub fn ask_and_print(
    bus: &Bus,
    key: &str,
    action: &str,
    argument: &str,
    json: bool,
) -> Result<Outcome> {
    let answer = ask(bus, key, action, argument)?;
    print_answer(&answer, json)?;
    Ok(if answer.done {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}

/// Sends a request to one service.
///
/// # Errors
/// No service answers.
pub fn ask(bus: &Bus, key: &str, action: &str, argument: &str) -> Result<Answer> {
    let request = Request {
        action: action.to_owned(),
        argument: argument.to_owned(),
    };
    bus.ask(key, &request, ANSWER_PATIENCE)
        .with_context(|| format!("`{action}` to {key}"))
}

/// Prints one answer, for a person or for a program.
///
/// # Errors
/// The answer cannot be written as JSON.
pub fn print_answer(answer: &Answer, json: bool) -> Result<()> {
    if json {
        return print_json(&json!({
            "done": answer.done,
            "message": answer.message,
            "data": data(answer),
        }));
    }
    println!("{}", answer.message);
    if !answer.data.is_empty()
        && let Value::Object(fields) = data(answer)
    {
        for (name, value) in fields {
            println!("  {name:<24} {value}");
        }
    }
    Ok(())
}

/// JSON data of an answer; null if it has none.
pub fn data(answer: &Answer) -> Value {
    serde_json::from_str(&answer.data).unwrap_or(Value::Null)
}
