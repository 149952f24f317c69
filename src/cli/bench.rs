//! `tangent bench`.

use clap::{Args, Subcommand};

use super::seconds::measuring_time;

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum Bench {
    /// Measure the duration of each step of sensing, estimation and control.
    Steps,
    /// Measure the round-trip time of a message, within one process and between processes, idle and
    /// under load.
    Bus(BenchBus),
    /// Measure the time from a stop to its answer and to a slower tool, in a private cell that is
    /// flooded with all other requests.
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
    /// Python interpreter with eclipse-zenoh installed.
    #[arg(long, default_value = "python3")]
    pub python: String,
}

/// Options of `tangent bench requests`.
#[derive(Debug, Args)]
pub struct BenchRequests {
    /// Number of stops to measure, with the flood and again without it.
    #[arg(long, default_value_t = 30)]
    pub stops: u32,
    /// Number added to all ports of the cell.
    #[arg(long, default_value_t = 9000)]
    pub port_offset: u16,
}

/// Options of `tangent bench peer`.
#[derive(Debug, Args)]
pub struct BenchPeer {
    /// Role of this process.
    pub role: BenchRole,
    /// Endpoint of the router.
    pub endpoint: String,
    /// Request SCHED_FIFO.
    #[arg(long)]
    pub realtime: bool,
}

/// Role of the other end of a measurement.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum BenchRole {
    /// The router.
    Router,
    /// Answers each message.
    Echo,
}
