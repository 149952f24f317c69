//! `tangent reproduce`: a paper's tables beside ours.

mod karacan;
mod lippiello;
mod page;

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use tangent_simulation::Evaluation;

use crate::cli::Reproduce;
use crate::evaluate::once;
use crate::output::{Outcome, print_json};

/// One figure of one row of one table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Table or section of the paper.
    pub table: &'static str,
    /// The paper's row and our preset.
    pub row: String,
    /// What is measured.
    pub metric: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The paper's figure; null where it prints none.
    pub published: Option<f64>,
    /// Over the seeds: mean of Tugal et al. and of Karacan et al., median of Lippiello et al.
    pub here: Option<f64>,
    /// The worst of the seeds.
    pub worst: Option<f64>,
    /// At most this, or at least where the metric says `least`; null where nothing is promised.
    pub goal: Option<f64>,
    /// `here` is within `goal`.
    pub met: Option<bool>,
}

#[derive(Serialize)]
struct Table {
    paper: &'static str,
    seeds: u64,
    rows: Vec<Row>,
}

/// One of the paper's three controllers, and the estimator that stands for it here.
struct Controller {
    published_name: &'static str,
    ours: &'static str,
    paper: &'static str,
    table_2: [f64; 2],
    table_3: [f64; 2],
}

const CONTROLLERS: [Controller; 3] = [
    Controller {
        published_name: "Adt. C.",
        ours: "reactive",
        paper: "reactive_paper",
        table_2: [2.713, 4.798],
        table_3: [19.348, 26.364],
    },
    Controller {
        published_name: "Adt. C.+ Quadratic",
        ours: "quadratic",
        paper: "quadratic_paper",
        table_2: [2.368, 4.61],
        table_3: [16.860, 21.695],
    },
    Controller {
        published_name: "Adt. C.+ GPR",
        ours: "blend",
        paper: "gaussian_process_paper",
        table_2: [2.411, 4.609],
        table_3: [15.731, 20.343],
    },
];

/// Runs every row over its seeds and prints the tables.
///
/// # Errors
/// When a scenario cannot be run.
pub fn run(args: &Reproduce, json: bool) -> Result<Outcome> {
    let mut tables = Vec::new();
    let wanted = |name: &str| args.paper == name || args.paper == "all";
    if wanted("tugal") {
        let seeds = args.seeds.unwrap_or(5).max(1);
        tables.push(Table {
            paper: "tugal",
            seeds,
            rows: tugal(seeds)?,
        });
    }
    if wanted("karacan") {
        let seeds = args.seeds.unwrap_or(10).max(1);
        tables.push(Table {
            paper: "karacan",
            seeds,
            rows: karacan::rows(seeds)?,
        });
        if let Some(folder) = &args.figures {
            karacan::draw(folder)?;
        }
    }
    if wanted("lippiello") {
        let seeds = args.seeds.unwrap_or(20).max(1);
        tables.push(Table {
            paper: "lippiello",
            seeds,
            rows: lippiello::rows(seeds)?,
        });
        if let Some(folder) = &args.figures {
            lippiello::draw(folder)?;
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

/// The bar of a command that runs many scenarios.
fn progress(runs: u64) -> ProgressBar {
    ProgressBar::new(runs).with_style(
        ProgressStyle::with_template("{bar:30} {pos}/{len} runs  {msg}")
            .expect("the template is well formed"),
    )
}

/// A figure of an evaluation; none when the run has no such figure.
type Pick = fn(&Evaluation) -> Option<f64>;

/// What one batch of runs contributes: metric, unit, published figure, goal, and where to read
/// ours.
type Metric = (&'static str, &'static str, Option<f64>, Option<f64>, Pick);

struct Batch {
    table: &'static str,
    row: String,
    scenario: &'static str,
    set: Vec<String>,
    metrics: Vec<Metric>,
}

fn batches() -> Vec<Batch> {
    let mut batches = Vec::new();
    for preset in ["default", "paper"] {
        let goal = |g: f64| (preset == "default").then_some(g);
        for c in &CONTROLLERS {
            let estimator = if preset == "paper" { c.paper } else { c.ours };
            let set = vec![
                format!("controller=\"{preset}\""),
                format!("task.estimators=[\"{estimator}\"]"),
            ];
            let row = format!(
                "{}, preset {preset}, estimator {estimator}",
                c.published_name
            );
            batches.push(Batch {
                table: "Table 2 (pipe, ideal sensing)",
                row: row.clone(),
                scenario: "pipe_ideal",
                set: set.clone(),
                metrics: vec![
                    (
                        "normal error, mean",
                        "deg",
                        Some(c.table_2[0]),
                        goal(1.0),
                        |e| e.figures.normal_error_deg.as_ref().map(|s| s.mean),
                    ),
                    (
                        "normal error, RMSE",
                        "deg",
                        Some(c.table_2[1]),
                        goal(2.0),
                        |e| e.figures.normal_error_deg.as_ref().map(|s| s.rmse),
                    ),
                    ("force while sliding, RMSE", "N", None, goal(0.10), |e| {
                        e.figures.force.rmse_n
                    }),
                ],
            });
            batches.push(Batch {
                table: "Table 3 (cone, realistic sensing)",
                row,
                scenario: "cone_realistic",
                set,
                metrics: vec![
                    (
                        "alignment, mean",
                        "deg",
                        Some(c.table_3[0]),
                        goal(6.0),
                        |e| e.figures.alignment_error_deg.as_ref().map(|s| s.mean),
                    ),
                    (
                        "alignment, RMSE",
                        "deg",
                        Some(c.table_3[1]),
                        goal(9.0),
                        |e| e.figures.alignment_error_deg.as_ref().map(|s| s.rmse),
                    ),
                    (
                        "tool against the true normal, mean",
                        "deg",
                        None,
                        None,
                        |e| e.figures.tool_error_deg.as_ref().map(|s| s.mean),
                    ),
                    ("force while sliding, RMSE", "N", None, goal(0.25), |e| {
                        e.figures.force.rmse_n
                    }),
                ],
            });
        }
        batches.push(Batch {
            table: "Touchdown at 10 kN/m",
            row: format!("preset {preset}"),
            scenario: "touchdown_10kN_per_m",
            set: vec![format!("controller=\"{preset}\"")],
            metrics: vec![("overshoot", "%", None, goal(30.0), |e| {
                e.figures.force.overshoot_percent
            })],
        });
    }
    batches
}

fn tugal(seeds: u64) -> Result<Vec<Row>> {
    let mut batches = batches();
    batches.sort_by_key(|batch| batch.table);
    let bar = progress(batches.len() as u64 * seeds);
    let mut rows = Vec::new();
    for batch in &batches {
        bar.set_message(batch.row.clone());
        let mut runs = Vec::new();
        for seed in 1..=seeds {
            let mut set = batch.set.clone();
            set.push(format!("seed={seed}"));
            runs.push(once(batch.scenario, &set)?);
            bar.inc(1);
        }
        for &(metric, unit, published, goal, pick) in &batch.metrics {
            // A run without the figure (it never touched, say) must not make the others look good.
            let values: Option<Vec<f64>> = runs.iter().map(pick).collect();
            let here = values
                .as_ref()
                .map(|v| v.iter().sum::<f64>() / v.len() as f64);
            let worst = values.map(|v| v.into_iter().fold(f64::NEG_INFINITY, f64::max));
            rows.push(Row {
                table: batch.table,
                row: batch.row.clone(),
                metric,
                unit,
                published,
                here,
                worst,
                goal,
                met: goal.map(|goal| here.is_some_and(|here| here <= goal)),
            });
        }
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
