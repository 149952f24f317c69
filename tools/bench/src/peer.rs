//! The other processes of a bus measurement: a router, or a peer that answers each message.

use std::io::Read;

use tangent_runtime::{Bus, BusError, CellConfig, Handle, Role, Stop};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics::{Delivery, Topic};

use crate::error::BenchError;

/// Role of the other process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeerRole {
    /// The router of all processes.
    Router,
    /// A peer that answers each message.
    Echo,
}

/// Topic of the measurement: its message has the size of the robot bridge's and the delivery of a
/// command.
pub const OUT: Topic<ArmState> = Topic::new("bench/out", Delivery::RealTime);
/// Topic of the answers.
pub const BACK: Topic<ArmState> = Topic::new("bench/back", Delivery::RealTime);

/// Configuration of a private cell at `endpoint`, with or without real-time scheduling.
pub fn cell(endpoint: &str, realtime: bool) -> CellConfig {
    let mut cell = CellConfig::default_cell();
    "bench".clone_into(&mut cell.cell.name);
    cell.zenoh.listen = vec![endpoint.to_owned()];
    cell.zenoh.connect = vec![endpoint.to_owned()];
    cell.realtime.enabled = realtime;
    cell
}

/// Sends each message back in the thread that receives it.
///
/// # Errors
/// The bus refuses a topic.
pub fn echo(bus: &Bus) -> Result<Handle, BusError> {
    let back = bus.publisher(&BACK)?;
    let handle = bus.on(&OUT, move |received| {
        back.publish(&received.message);
    })?;
    Ok(handle)
}

/// Runs until standard input ends, which happens when the parent process ends. `endpoint` is the
/// router's address; with `realtime` the process asks for SCHED_FIFO.
///
/// # Errors
/// The bus cannot be opened.
pub fn run(role: PeerRole, endpoint: &str, realtime: bool) -> Result<(), BenchError> {
    let cell = cell(endpoint, realtime);
    let bus_role = match role {
        PeerRole::Router => Role::Router,
        PeerRole::Echo => Role::Client,
    };
    let bus = Bus::open_until(&cell, bus_role, None, &Stop::new())?;
    let _answering = match role {
        PeerRole::Router => None,
        PeerRole::Echo => Some(echo(&bus)?),
    };
    std::io::stdin()
        .read_to_end(&mut Vec::new())
        .map_err(BenchError::StandardInput)?;
    Ok(())
}
