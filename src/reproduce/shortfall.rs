//! What a reproduction lacks: runs that did not end `done`, and published rows that this program
//! does not reproduce, each with the reason.

use std::collections::BTreeMap;

use serde::Serialize;
use tangent_simulation::Evaluation;
use tangent_simulation::reproduction::Row;

use crate::output::or_dash;
use crate::table::paragraph;

/// A run that did not end in phase `done`. Its figures are in the table, but cover only the part
/// of the task until then.
#[derive(Debug, Serialize)]
pub(super) struct Unfinished {
    /// The paper's row and our preset, as in the table.
    row: String,
    /// Scenario of the run.
    scenario: String,
    /// Seed of the run.
    seed: u64,
    /// Phase at the end.
    phase: &'static str,
    /// Fault that ended the task; null if the time was up.
    fault: Option<String>,
}

impl Unfinished {
    /// The unfinished ones of the runs of one row.
    pub fn among<'a>(row: &str, runs: &'a [Evaluation]) -> impl Iterator<Item = Self> + use<'a> {
        let row = row.to_owned();
        let unfinished = runs.iter().filter(|run| run.phase != "done");
        unfinished.map(move |run| Self {
            row: row.clone(),
            scenario: run.scenario.clone(),
            seed: run.seed,
            phase: run.phase,
            fault: run.fault.map(|fault| fault.to_string()),
        })
    }
}

/// A published row that this program does not reproduce with the published method.
#[derive(Debug, Serialize)]
pub(super) struct NotReproduced {
    /// Table or section of the paper.
    table: &'static str,
    /// The paper's row and our preset, as in the table.
    row: String,
    /// Number of runs that did not end `done`.
    unfinished_runs: usize,
    /// Number of runs.
    runs: usize,
    /// Figures that the paper states, beside those of the same method here.
    figures: Vec<Figure>,
    /// Reason, as far as it is known.
    why: Option<&'static str>,
}

#[derive(Debug, Serialize)]
struct Figure {
    metric: &'static str,
    unit: &'static str,
    published: f64,
    here: Option<f64>,
    worst: Option<f64>,
}

/// Factor above the published value from which a row counts as not reproduced.
const FAR: f64 = 2.0;

/// Row of the published estimator that fits a quadratic surface, in the table of the pipe.
const QUADRATIC: (&str, &str) = ("Table 2", "estimator quadratic_paper");
const QUADRATIC_WHY: &str = "After the raster's corner, the window of points holds two ends of strokes that meet at a \
    right angle. They do not determine the six coefficients of the quadratic surface, which the paper fits without \
    regularisation. The normal turns away from the surface until it is unusable, and a fault ends the task.";

impl NotReproduced {
    /// Judges a row that repeats a published method: `None` if every run ended `done` and each
    /// figure is near the published one, or better.
    pub fn judge(rows: &[Row], runs: &[Evaluation]) -> Option<Self> {
        let first = rows.first()?;
        let unfinished = runs.iter().filter(|run| run.phase != "done").count();
        let figures: Vec<Figure> = rows.iter().filter_map(Figure::of).collect();
        if figures.is_empty() || (unfinished == 0 && !figures.iter().any(Figure::is_far)) {
            return None;
        }
        let quadratic = first.table.starts_with(QUADRATIC.0) && first.row.ends_with(QUADRATIC.1);
        Some(Self {
            table: first.table,
            row: first.row.clone(),
            unfinished_runs: unfinished,
            runs: runs.len(),
            figures,
            why: quadratic.then_some(QUADRATIC_WHY),
        })
    }
}

impl Figure {
    fn of(row: &Row) -> Option<Self> {
        Some(Self {
            metric: row.metric,
            unit: row.unit,
            published: row.published?,
            here: row.here,
            worst: row.worst,
        })
    }

    fn is_far(&self) -> bool {
        self.here.is_none_or(|here| here > FAR * self.published)
    }
}

/// Prints both lists; nothing if they are empty.
pub(super) fn print(unfinished: &[Unfinished], not_reproduced: &[NotReproduced]) {
    if !unfinished.is_empty() {
        println!("\nRuns that did not end `done`: the command fails");
        let mut groups: BTreeMap<_, Vec<String>> = BTreeMap::new();
        for run in unfinished {
            let ending = (&run.row, &run.scenario, run.phase, &run.fault);
            groups.entry(ending).or_default().push(run.seed.to_string());
        }
        for ((row, scenario, phase, fault), seeds) in groups {
            let seeds = seeds.join(", ");
            paragraph(2, row);
            let fault = fault
                .as_ref()
                .map_or_else(String::new, |fault| format!(": {fault}"));
            let ending = format!("{scenario}, seed {seeds}: ended in phase {phase}{fault}");
            paragraph(4, &ending);
        }
    }
    for row in not_reproduced {
        println!();
        paragraph(0, &format!("NOT REPRODUCED: {}, {}", row.table, row.row));
        for f in &row.figures {
            println!(
                "  {}: {} {unit} (worst seed {}), published {:.2} {unit}",
                f.metric,
                or_dash(f.here, 2),
                or_dash(f.worst, 2),
                f.published,
                unit = f.unit
            );
        }
        println!(
            "  {} of {} runs did not end `done`",
            row.unfinished_runs, row.runs
        );
        if let Some(why) = row.why {
            paragraph(2, why);
        }
    }
}
