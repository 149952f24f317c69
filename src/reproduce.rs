//! `tangent reproduce`: prints a paper's tables beside ours.

mod object;
mod page;
mod shortfall;
mod visuo_tactile;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::Result;
use indicatif::ProgressBar;
use serde::Serialize;
use tangent_simulation::Evaluation;
use tangent_simulation::reproduction::Row;
use tangent_simulation::systems::admittance::reproduction::batches;

use crate::cli::Reproduce;
use crate::evaluate::once;
use crate::output::{Outcome, or_dash, print_json};
use crate::table::{Columns, paragraph};
use crate::terminal;
use shortfall::{NotReproduced, Unfinished};

#[derive(Serialize)]
struct Table {
    paper: &'static str,
    seeds: u64,
    #[serde(flatten)]
    found: Found,
}

/// Figures of one paper, and what is missing in them.
#[derive(Default, Serialize)]
struct Found {
    rows: Vec<Row>,
    unfinished: Vec<Unfinished>,
    not_reproduced: Vec<NotReproduced>,
}

/// Runs every row over its seeds and prints the tables. The command fails if a goal is not met or
/// if any run does not end `done`, the published methods included.
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
            found: admittance(seeds)?,
        });
    }
    if wanted("karacan") {
        let seeds = args.seeds.unwrap_or(10).max(1);
        tables.push(Table {
            paper: "karacan",
            seeds,
            found: visuo_tactile::run(seeds)?,
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
            found: object::run(seeds)?,
        });
        if let Some(folder) = &args.figures {
            object::draw(folder)?;
        }
    }
    let met = tables
        .iter()
        .flat_map(|table| &table.found.rows)
        .all(|row| row.met != Some(false));
    let finished = tables.iter().all(|table| table.found.unfinished.is_empty());
    match (json, tables.as_slice()) {
        (true, [table]) => print_json(table)?,
        (true, several) => print_json(&several)?,
        (false, several) => several.iter().for_each(|table| print(&table.found)),
    }
    Ok(if met && finished {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}

/// Progress bar of a command that runs many scenarios.
fn progress(runs: u64) -> ProgressBar {
    terminal::bar(runs, "{bar:20} {pos}/{len} runs  {wide_msg}")
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

/// Part of the name of a row that repeats the published method with the published parameters.
const PAPER_PRESET: &str = "preset paper";

fn admittance(seeds: u64) -> Result<Found> {
    let batches = batches();
    let bar = progress(batches.len() as u64 * seeds);
    let mut found = Found::default();
    for batch in &batches {
        bar.set_message(batch.name().to_owned());
        let runs = over_seeds(batch.scenario(), batch.overrides(), seeds, 1, &bar)?;
        let rows = batch.rows(&runs);
        if batch.name().contains(PAPER_PRESET) {
            let judged = NotReproduced::judge(&rows, &runs);
            found.not_reproduced.extend(judged);
        }
        let unfinished = Unfinished::among(batch.name(), &runs);
        found.unfinished.extend(unfinished);
        found.rows.extend(rows);
    }
    bar.finish_and_clear();
    Ok(found)
}

fn print(found: &Found) {
    let mut printed = "";
    let rows = &found.rows;
    for group in rows.chunk_by(|a, b| a.table == b.table && a.row == b.row) {
        let Some(first) = group.first() else { continue };
        if first.table != printed {
            printed = first.table;
            println!("\n{printed}");
        }
        paragraph(2, &first.row);
        let mut table = Columns::new(&["", ">published", ">here", ">worst", ">goal", "unit", ""]);
        for row in group {
            table.row([
                row.metric.to_owned(),
                or_dash(row.published, 3),
                or_dash(row.here, 3),
                or_dash(row.worst, 3),
                or_dash(row.goal, 3),
                row.unit.to_owned(),
                match row.met {
                    Some(true) => "met",
                    Some(false) => "NOT MET",
                    None => "",
                }
                .to_owned(),
            ]);
        }
        table.print(4);
    }
    shortfall::print(&found.unfinished, &found.not_reproduced);
}
