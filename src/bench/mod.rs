//! `tangent bench`: how long each step takes, and how long a message takes over the bus, measured
//! on this machine.

mod bus;
mod load;
mod peer;
mod python;
mod requests;
mod steps;

use anyhow::Result;
use serde::Serialize;

use crate::cli::Bench;
use crate::output::{Outcome, print_json};
use crate::report::Quantiles;

/// One thing measured.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// What, and under which conditions.
    pub name: String,
    /// How many times.
    pub n: usize,
    /// Median, µs.
    pub p50_us: f64,
    /// 99 of 100 are faster, µs.
    pub p99_us: f64,
    /// 999 of 1000 are faster, µs.
    pub p999_us: f64,
    /// Slowest, µs.
    pub max_us: f64,
    /// Messages that were never answered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost: Option<usize>,
}

impl Row {
    /// From single durations, µs; none when nothing was measured.
    pub fn of(name: impl Into<String>, us: Vec<f64>) -> Option<Self> {
        let n = us.len();
        let q = Quantiles::of(us)?;
        Some(Self {
            name: name.into(),
            n,
            p50_us: q.p50,
            p99_us: q.p99,
            p999_us: q.p999,
            max_us: q.max,
            lost: None,
        })
    }
}

#[derive(Serialize)]
struct Table {
    machine: Machine,
    rows: Vec<Row>,
    /// What was not measured, and why.
    skipped: Vec<String>,
}

/// Figures mean nothing without it.
#[derive(Serialize)]
struct Machine {
    cores: usize,
    kernel: String,
    load_average: String,
}

impl Machine {
    fn this() -> Self {
        let read = |path: &str| {
            std::fs::read_to_string(path)
                .map(|text| text.trim().to_owned())
                .unwrap_or_default()
        };
        Self {
            cores: load::cores(),
            kernel: read("/proc/sys/kernel/osrelease"),
            load_average: read("/proc/loadavg"),
        }
    }
}

/// Measures, and prints a table.
///
/// # Errors
/// A process that cannot be started, or a bus that cannot be opened.
pub fn run(bench: &Bench, json: bool) -> Result<Outcome> {
    let machine = Machine::this();
    let mut skipped = Vec::new();
    let rows = match bench {
        Bench::Steps => steps::run()?,
        Bench::Bus(options) => bus::run(options, &mut skipped)?,
        Bench::Requests(options) => requests::run(options)?,
        Bench::Peer(options) => {
            peer::run(options)?;
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
    println!(
        "{:<64} {:>8} {:>9} {:>9} {:>9} {:>10} {:>5}",
        "", "n", "p50", "p99", "p99.9", "max", "lost"
    );
    for row in &rows {
        println!(
            "{:<64} {:>8} {:>9.1} {:>9.1} {:>9.1} {:>10.1} {:>5}",
            row.name,
            row.n,
            row.p50_us,
            row.p99_us,
            row.p999_us,
            row.max_us,
            row.lost.map(|n| n.to_string()).unwrap_or_default()
        );
    }
    for line in &skipped {
        println!("{line}");
    }
    Ok(Outcome::Done)
}
