//! The other processes of a bus measurement: a router, or somebody who answers each message.

use std::io::Read;

use anyhow::{Context, Result};
use tangent_runtime::{Bus, CellConfig, Handle, Role, Stop};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics::{Delivery, Topic};

use crate::cli::{BenchPeer, BenchRole};

/// What is measured with: as large as what the robot bridge sends, and as urgent as a command.
pub const OUT: Topic<ArmState> = Topic::new("bench/out", Delivery::RealTime);
/// The answers.
pub const BACK: Topic<ArmState> = Topic::new("bench/back", Delivery::RealTime);

/// A cell of its own at `endpoint`, with or without real-time scheduling.
pub fn cell(endpoint: &str, realtime: bool) -> CellConfig {
    let mut cell = CellConfig::default_cell();
    "bench".clone_into(&mut cell.cell.name);
    cell.zenoh.listen = vec![endpoint.to_owned()];
    cell.zenoh.connect = vec![endpoint.to_owned()];
    cell.realtime.enabled = realtime;
    cell
}

/// Sends back whatever comes, in the thread that brings it.
///
/// # Errors
/// A topic that the bus refuses.
pub fn echo(bus: &Bus) -> Result<Handle> {
    let back = bus.publisher(&BACK)?;
    let handle = bus.on(&OUT, move |received| {
        back.publish(&received.message);
    })?;
    Ok(handle)
}

/// Runs until standard input ends: with the process that asked for it.
///
/// # Errors
/// A bus that cannot be opened.
pub fn run(options: &BenchPeer) -> Result<()> {
    let cell = cell(&options.endpoint, options.realtime);
    let role = match options.role {
        BenchRole::Router => Role::Router,
        BenchRole::Echo => Role::Client,
    };
    let bus = Bus::open_until(&cell, role, None, &Stop::new())?;
    let _answering = match options.role {
        BenchRole::Router => None,
        BenchRole::Echo => Some(echo(&bus)?),
    };
    std::io::stdin()
        .read_to_end(&mut Vec::new())
        .context("waiting for the end of standard input")?;
    Ok(())
}
