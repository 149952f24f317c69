//! A session of an operator on a cell's bus, and requests to its services.

use std::time::Duration;

use serde_json::Value;
use tangent_runtime::{Bus, CellConfig, Role, Stop};
use tangent_schemas::tangent::{Answer, Request};

use crate::error::ClientError;

/// Time that a command waits for the cell's router.
pub const ROUTER_PATIENCE: Duration = Duration::from_secs(3);
/// Time that a command waits for a service's answer.
pub const ANSWER_PATIENCE: Duration = Duration::from_secs(5);

/// Joins the cell's network as a client.
///
/// # Errors
/// No router answers.
pub fn join(config: &CellConfig) -> Result<Bus, ClientError> {
    join_within(config, ROUTER_PATIENCE, &Stop::new())
}

/// Joins the cell's network as a client. Waits for the router for at most `patience`, or until
/// `stop` is triggered.
///
/// # Errors
/// No router answers in time.
pub fn join_within(
    config: &CellConfig,
    patience: Duration,
    stop: &Stop,
) -> Result<Bus, ClientError> {
    let mut config = as_operator(config);
    // An interactive command needs no real-time priority.
    config.realtime.enabled = false;
    Bus::open_until(&config, Role::Client, Some(patience), stop).map_err(|source| {
        ClientError::Unreachable {
            cell: config.cell.name.clone(),
            source: Box::new(source),
        }
    })
}

/// Joins the network of all cells as a client.
///
/// # Errors
/// No router answers.
pub fn join_all(config: &CellConfig) -> Result<Bus, ClientError> {
    Ok(Bus::open_network(
        &as_operator(config).zenoh,
        ROUTER_PATIENCE,
    )?)
}

/// A command without an explicit identity uses that of an operator.
fn as_operator(config: &CellConfig) -> CellConfig {
    let mut config = config.clone();
    config.zenoh.identify("operator");
    config
}

/// Sends a request to one service.
///
/// # Errors
/// No service answers.
pub fn ask(bus: &Bus, key: &str, action: &str, argument: &str) -> Result<Answer, ClientError> {
    let request = Request {
        action: action.to_owned(),
        argument: argument.to_owned(),
    };
    bus.ask(key, &request, ANSWER_PATIENCE)
        .map_err(|source| ClientError::NoAnswer {
            action: action.to_owned(),
            key: key.to_owned(),
            source: Box::new(source),
        })
}

/// JSON data of an answer; null if it has none.
pub fn data(answer: &Answer) -> Value {
    serde_json::from_str(&answer.data).unwrap_or(Value::Null)
}
