//! `tangent bench`.

use clap::{Args, Subcommand};

use super::seconds::measuring_time;

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum Bench {
    /// How long each step of sensing, estimation and control takes.
    Steps,
    /// How long a message takes there and back, within one process and between processes, idle and
    /// loaded.
    Bus(BenchBus),
    /// How soon a stop is answered, and the tool slower, in a cell of its own that is flooded with
    /// every other request.
    Requests(BenchRequests),
    /// The other end of a measurement; started by `bus`.
    #[command(hide = true)]
    Peer(BenchPeer),
}

/// Options of `tangent bench bus`.
#[derive(Debug, Args)]
pub struct BenchBus {
    /// Length of each measurement, s.
    #[arg(long, default_value_t = 3.0, value_parser = measuring_time)]
    pub seconds: f64,
    /// Python that has eclipse-zenoh.
    #[arg(long, default_value = "python3")]
    pub python: String,
}

/// Options of `tangent bench requests`.
#[derive(Debug, Args)]
pub struct BenchRequests {
    /// Stops that are measured, with and without the flood each.
    #[arg(long, default_value_t = 30)]
    pub stops: u32,
    /// Added to all ports of the cell.
    #[arg(long, default_value_t = 9000)]
    pub port_offset: u16,
}

/// Options of `tangent bench peer`.
#[derive(Debug, Args)]
pub struct BenchPeer {
    /// What to be.
    pub role: BenchRole,
    /// Where the router is, or is to be.
    pub endpoint: String,
    /// Ask for SCHED_FIFO.
    #[arg(long)]
    pub realtime: bool,
}

/// What the other end is.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum BenchRole {
    /// Everybody's router.
    Router,
    /// Answers each message.
    Echo,
}
