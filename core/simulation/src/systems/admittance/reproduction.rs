//! The tables that `tangent reproduce tugal` prints: the paper's three controllers, with its
//! parameters and with ours.

use crate::evaluation::Evaluation;
use crate::reproduction::{Goal, Metric, Over, Row, picked};

/// One of the paper's three controllers, and the estimator that stands for it here.
struct Controller {
    published_name: &'static str,
    ours: &'static str,
    paper: &'static str,
    /// Mean and RMSE of the normal's error, deg.
    table_2: [f64; 2],
    /// Mean and RMSE of the alignment, deg.
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

/// A figure of an evaluation; `None` if the run has no such figure.
type Pick = fn(&Evaluation) -> Option<f64>;

/// Runs that make one row of the table: one per seed.
pub struct Batch {
    table: &'static str,
    row: String,
    scenario: &'static str,
    overrides: Vec<String>,
    metrics: Vec<(Metric, Pick)>,
}

impl Batch {
    /// The paper's row and our preset.
    pub fn name(&self) -> &str {
        &self.row
    }

    /// Name of the scenario that the batch runs.
    pub fn scenario(&self) -> &'static str {
        self.scenario
    }

    /// Overrides of the scenario.
    pub fn overrides(&self) -> &[String] {
        &self.overrides
    }

    /// Rows of figures from the runs, one run per seed.
    pub fn rows(&self, runs: &[Evaluation]) -> Vec<Row> {
        let row = |(metric, pick): &(Metric, Pick)| {
            Row::new(
                self.table,
                &self.row,
                *metric,
                picked(runs, pick).as_deref(),
            )
        };
        self.metrics.iter().map(row).collect()
    }
}

/// All batches, in the order of the paper's tables.
pub fn batches() -> Vec<Batch> {
    let mut batches = Vec::new();
    for preset in ["default", "paper"] {
        let ours = preset == "default";
        for controller in &CONTROLLERS {
            let estimator = if ours {
                controller.ours
            } else {
                controller.paper
            };
            let row = format!(
                "{}, preset {preset}, estimator {estimator}",
                controller.published_name
            );
            let overrides = vec![
                format!("controller=\"{preset}\""),
                format!("task.estimators=[\"{estimator}\"]"),
            ];
            batches.push(Batch {
                table: "Table 2 (pipe, ideal sensing)",
                row: row.clone(),
                scenario: "pipe_ideal",
                overrides: overrides.clone(),
                metrics: table_2(controller.table_2, ours),
            });
            batches.push(Batch {
                table: "Table 3 (cone, realistic sensing)",
                row,
                scenario: "cone_realistic",
                overrides,
                metrics: table_3(controller.table_3, ours),
            });
        }
        batches.push(Batch {
            table: "Touchdown at 10 kN/m",
            row: format!("preset {preset}"),
            scenario: "touchdown_10kN_per_m",
            overrides: vec![format!("controller=\"{preset}\"")],
            metrics: vec![(metric("overshoot", "%", None, ours.then_some(30.0)), |e| {
                e.figures.force.overshoot_percent
            })],
        });
    }
    batches.sort_by_key(|batch| batch.table);
    batches
}

fn metric(
    name: &'static str,
    unit: &'static str,
    published: Option<f64>,
    goal: Option<f64>,
) -> Metric {
    Metric {
        name,
        unit,
        published,
        goal: Goal::at_most(goal),
        over: Over::Mean,
    }
}

fn table_2([mean, rmse]: [f64; 2], ours: bool) -> Vec<(Metric, Pick)> {
    let goal = |goal: f64| ours.then_some(goal);
    vec![
        (
            metric("normal error, mean", "deg", Some(mean), goal(1.0)),
            |e| e.figures.normal_error_deg.as_ref().map(|s| s.mean),
        ),
        (
            metric("normal error, RMSE", "deg", Some(rmse), goal(2.0)),
            |e| e.figures.normal_error_deg.as_ref().map(|s| s.rmse),
        ),
        (
            metric("force while sliding, RMSE", "N", None, goal(0.10)),
            |e| e.figures.force.rmse_n,
        ),
    ]
}

fn table_3([mean, rmse]: [f64; 2], ours: bool) -> Vec<(Metric, Pick)> {
    let goal = |goal: f64| ours.then_some(goal);
    vec![
        (
            metric("alignment, mean", "deg", Some(mean), goal(6.0)),
            |e| e.figures.alignment_error_deg.as_ref().map(|s| s.mean),
        ),
        (
            metric("alignment, RMSE", "deg", Some(rmse), goal(9.0)),
            |e| e.figures.alignment_error_deg.as_ref().map(|s| s.rmse),
        ),
        (
            metric("tool against the true normal, mean", "deg", None, None),
            |e| e.figures.tool_error_deg.as_ref().map(|s| s.mean),
        ),
        (
            metric("force while sliding, RMSE", "N", None, goal(0.25)),
            |e| e.figures.force.rmse_n,
        ),
    ]
}
