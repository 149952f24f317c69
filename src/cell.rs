//! The cell file of a command, and output of answers from a cell's services.

use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};
use tangent_client::session::{ask, data};
use tangent_runtime::{Bus, CellConfig};
use tangent_schemas::tangent::Answer;

use crate::output::{Outcome, bad_usage, print_json};
use crate::table::message;

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
    tangent_compose::model(&config).map_err(|e| bad_usage(format!("{}: {e}", path.display())))?;
    if let Some(identity) = identity {
        config.zenoh.identify(identity);
    }
    Ok(config)
}

/// Replaces the routers of the cell file by those of `--connect`, if there are any.
///
/// # Errors
/// An endpoint without certificates for a cell that has them: exit code 2.
pub fn connect(config: &mut CellConfig, endpoints: &[String]) -> Result<()> {
    if endpoints.is_empty() {
        return Ok(());
    }
    let clear = endpoints.iter().find(|e| !e.starts_with("quic/"));
    if let (Some(_), Some(clear)) = (&config.zenoh.tls, clear) {
        return Err(bad_usage(format!(
            "--connect {clear}: cell {} has certificates ([zenoh.tls]), so the endpoint is one such as quic/router.local:7447",
            config.cell.name
        )));
    }
    config.zenoh.connect = endpoints.to_vec();
    Ok(())
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
    message(0, &answer.message);
    if !answer.data.is_empty()
        && let Value::Object(fields) = data(answer)
    {
        for (name, value) in fields {
            println!("  {name:<24} {value}");
        }
    }
    Ok(())
}
