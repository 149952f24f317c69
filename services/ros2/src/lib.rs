//! The ROS 2 service: a node of ROS 2, over rmw_zenoh, that shows the cell's topics and offers its
//! commands.
//!
//! It has two sessions: that of the cell's bus, and one on the network of ROS 2, which has keys of
//! its own. What ROS 2 sees is what the cell file lists; what ROS 2 may send is checked here,
//! before it reaches the cell: its type, its content, and that it comes from one publisher in
//! order.

mod commands;
mod config;
mod error;
mod inputs;
mod names;
mod node;
mod one_source;
mod outputs;
mod troubles;
pub mod type_hash;

use std::time::{Duration, Instant};

use tangent_runtime::{Beat, Bus, BusError, HealthReporter, PlainSession, RealtimeReport, Stop};

use commands::Commands;
pub use commands::{SelectEstimatorRequest, StartTaskRequest, TriggerResponse};
pub use config::{Config, Input, InputKind};
pub use error::Ros2Error;
use node::Node;
use outputs::Outputs;
use troubles::Troubles;

/// Name in topics and health messages.
pub const SERVICE: &str = "ros2";
/// Name of the node in ROS 2; its namespace is the prefix.
pub const NODE: &str = "tangent";
/// Longest wait for a message, and interval of the other work.
const LOOK: Duration = Duration::from_millis(50);

/// Runs until `stop`. Blocks. Waits for a router of ROS 2 without a time limit.
///
/// # Errors
/// Another ROS 2 service runs in the cell, or a network refuses a topic.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), Ros2Error> {
    let health = HealthReporter::start_only(&bus, SERVICE)?;
    health.realtime(&RealtimeReport::not_asked(SERVICE));
    let routers = config.connect.join(", ");
    health.degraded(format_args!("no router of ROS 2 at {routers} so far"));
    let session = match PlainSession::open(&config.zenoh, &config.connect, None, &stop) {
        Ok(session) => session,
        Err(BusError::Stopped) => return Ok(()),
        Err(error) => return Err(error.into()),
    };
    let served = serve(&config, &bus, &session, &health, &stop);
    session.close();
    served
}

fn serve(
    config: &Config,
    bus: &Bus,
    session: &PlainSession,
    health: &HealthReporter,
    stop: &Stop,
) -> Result<(), Ros2Error> {
    let namespace = format!("/{}", config.prefix);
    let node = Node::start(session.clone(), config.domain, &namespace, NODE)?;
    let troubles = Troubles::default();
    let mut outputs = Outputs::new(config, bus, &node, troubles.clone(), health)?;
    let mut inputs = Vec::new();
    for input in &config.inputs {
        inputs.push(inputs::open(input, bus, &node, &troubles, health)?);
    }
    let commands = Commands::open(
        &config.commands,
        &config.prefix,
        bus,
        &node,
        &troubles,
        health,
    )?;
    health.running();
    tracing::info!("node {namespace}/{NODE} in domain {}", config.domain);
    let beat = Beat::new(SERVICE);
    let mut said: Option<String> = None;
    while !stop.is_stopped() {
        beat.beat();
        outputs.turn(&node, LOOK)?;
        let trouble = if node.is_connected() {
            troubles.first(Instant::now())
        } else {
            Some(format!(
                "no router of ROS 2 at {}",
                config.connect.join(", ")
            ))
        };
        if trouble != said {
            match &trouble {
                Some(words) => health.degraded(format_args!("{words}")),
                None => health.running(),
            }
            said = trouble;
        }
    }
    drop(beat);
    drop(commands);
    drop(inputs);
    Ok(())
}
