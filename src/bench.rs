//! `tangent bench`: the time of each step, and of a message over the bus, measured on this machine.

use anyhow::Result;
use serde::Serialize;
use tangent_bench::{Machine, Row, bus, peer, requests, steps};

use crate::cli::{Bench, BenchRole};
use crate::output::{Outcome, print_json};
use crate::table::{Columns, paragraph};

#[derive(Serialize)]
struct Table {
    machine: Machine,
    rows: Vec<Row>,
    /// Measurements that were skipped, with the reason.
    skipped: Vec<String>,
}

/// Runs the measurements, and prints a table.
///
/// # Errors
/// A process cannot be started, or a bus cannot be opened.
pub fn run(bench: &Bench, json: bool) -> Result<Outcome> {
    let machine = Machine::this();
    let mut skipped = Vec::new();
    let rows = match bench {
        Bench::Steps => steps::run()?,
        Bench::Bus(args) => {
            let options = bus::Options {
                seconds: args.seconds,
                python: args.python.clone(),
                program: std::env::current_exe()?,
            };
            bus::run(&options, &mut skipped)?
        }
        Bench::Requests(args) => {
            let options = requests::Options {
                stops: args.stops,
                port_offset: args.port_offset,
                program: std::env::current_exe()?,
            };
            requests::run(&options)?
        }
        Bench::Peer(args) => {
            let role = match args.role {
                BenchRole::Router => peer::PeerRole::Router,
                BenchRole::Echo => peer::PeerRole::Echo,
            };
            peer::run(role, &args.endpoint, args.realtime)?;
            return Ok(Outcome::Done);
        }
    };
    if json {
        print_json(&Table {
            machine,
            rows,
            skipped,
        })?;
        return Ok(Outcome::Done);
    }
    println!(
        "{} cores, Linux {}, load {} at the start; times in µs",
        machine.cores, machine.kernel, machine.load_average
    );
    let mut table = Columns::new(&["", ">n", ">p50", ">p99", ">p99.9", ">max", ">lost"]);
    for row in &rows {
        table.row([
            row.name.clone(),
            row.n.to_string(),
            format!("{:.1}", row.p50_us),
            format!("{:.1}", row.p99_us),
            format!("{:.1}", row.p999_us),
            format!("{:.1}", row.max_us),
            row.lost.map(|n| n.to_string()).unwrap_or_default(),
        ]);
    }
    table.print(0);
    for line in &skipped {
        paragraph(0, line);
    }
    Ok(Outcome::Done)
}
