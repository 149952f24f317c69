//! `tangent reproduce`: prints a paper's tables beside ours.

mod object;
mod page;
mod visuo_tactile;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use tangent_simulation::Evaluation;
use tangent_simulation::reproduction::Row;
use tangent_simulation::systems::admittance::reproduction::batches;

use crate::cli::Reproduce;
use crate::evaluate::once;
use crate::output::{Outcome, print_json};

#[derive(Serialize)]
struct Table {
    paper: &'static str,
    seeds: u64,
    rows: Vec<Row>,
}

/// Runs every row over its seeds and prints the tables.
///
/// # Errors
/// A scenario cannot be run.
pub fn run(args: &Reproduce, json: bool) -> Result<Outcome> {
    let mut tables = Vec::new();
    let wanted = |name: &str| args.paper == name || args.paper == "all";
    if wanted("tugal") {
        let seeds = args.seeds.unwrap_or(5).max(1);
        tables.push(Table {
            paper: "tugal",
            seeds,
            rows: admittance(seeds)?,
        });
    }
    if wanted("karacan") {
        let seeds = args.seeds.unwrap_or(10).max(1);
        tables.push(Table {
            paper: "karacan",
            seeds,
            rows: visuo_tactile::rows(seeds)?,
        });
        if let Some(folder) = &args.figures {
            visuo_tactile::draw(folder)?;
        }
    }
    if wanted("lippiello") {
        let seeds = args.seeds.unwrap_or(20).max(1);
        tables.push(Table {
            paper: "lippiello",
            seeds,
            rows: object::rows(seeds)?,
        });
        if let Some(folder) = &args.figures {
            object::draw(folder)?;
        }
    }
    let met = tables
        .iter()
        .flat_map(|table| &table.rows)
        .all(|row| row.met != Some(false));
    match (json, tables.as_slice()) {
        (true, [table]) => print_json(table)?,
        (true, several) => print_json(&several)?,
        (false, several) => several.iter().for_each(|table| print(&table.rows)),
    }
    Ok(if met { Outcome::Done } else { Outcome::Failed })
}

/// Progress bar of a command that runs many scenarios.
fn progress(runs: u64) -> ProgressBar {
    ProgressBar::new(runs).with_style(
        ProgressStyle::with_template("{bar:30} {pos}/{len} runs  {msg}")
            .expect("the template is well formed"),
    )
}

/// Runs once per seed, `workers` at a time; the results are in the order of the seeds.
///
/// # Errors
/// A run cannot be started.
fn over_seeds(
    scenario: &str,
    overrides: &[String],
    seeds: u64,
    workers: usize,
    bar: &ProgressBar,
) -> Result<Vec<Evaluation>> {
    let next = AtomicU64::new(1);
    let done = Mutex::new(BTreeMap::new());
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed > seeds {
                return;
            }
            let mut set = overrides.to_vec();
            set.push(format!("seed={seed}"));
            let run = once(scenario, &set);
            done.lock()
                .unwrap_or_else(PoisonError::into_inner)
                .insert(seed, run);
            bar.inc(1);
        }
    };
    thread::scope(|scope| {
        for _ in 1..workers {
            scope.spawn(work);
        }
        work();
    });
    let done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.into_values().collect()
}

fn admittance(seeds: u64) -> Result<Vec<Row>> {
    let batches = batches();
    let bar = progress(batches.len() as u64 * seeds);
    let mut rows = Vec::new();
    for batch in &batches {
        bar.set_message(batch.name().to_owned());
        let runs = over_seeds(batch.scenario(), batch.overrides(), seeds, 1, &bar)?;
        rows.extend(batch.rows(&runs));
    }
    bar.finish_and_clear();
    Ok(rows)
}

fn print(rows: &[Row]) {
    let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.3}"));
    let mut table = "";
    let mut name = "";
    for row in rows {
        if row.table != table {
            table = row.table;
            name = "";
            println!("\n{table}");
        }
        if row.row != name {
            name = &row.row;
            println!("  {name}");
        }
        println!(
            "    {:<36} published {:>7}   here {:>7}   worst {:>7}   goal {:>6} {}  {}",
            row.metric,
            number(row.published),
            number(row.here),
            number(row.worst),
            number(row.goal),
            row.unit,
            match row.met {
                Some(true) => "met",
                Some(false) => "NOT MET",
                None => "",
            }
        );
    }
}
