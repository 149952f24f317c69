//! How honest the estimators' covariances are: mean of the normalised squared error per scenario, estimator and phase.
//!
//! `cargo run --release -p tangent-simulation --example nees -- [seeds=5] [scenario=NAME…] [key=value…]`
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::path::Path;
use std::process::ExitCode;

use tangent_control::Phase;
use tangent_simulation::metrics::{angle_deg, nees_of_normal};
use tangent_simulation::{Scenario, evaluate_with};

/// The sound estimators: `blend` steers, the others listen.
const ESTIMATORS: [&str; 4] = ["blend", "reactive", "quadratic", "gaussian_process"];
/// Touching down, sliding, standing.
const PHASES: [&str; 3] = ["contact", "slide", "hold"];

/// Sums over the cycles of one phase.
#[derive(Clone, Copy, Default)]
struct Tally {
    nees: f64,
    square_deg: f64,
    variance_deg: f64,
    count: f64,
}

impl Tally {
    fn merge(&mut self, other: &Self) {
        self.nees += other.nees;
        self.square_deg += other.square_deg;
        self.variance_deg += other.variance_deg;
        self.count += other.count;
    }

    /// NEES, and per axis the error and the claim, degrees.
    fn text(&self) -> String {
        if self.count == 0.0 {
            return "-".to_owned();
        }
        let per_axis = |sum: f64| (0.5 * sum / self.count).sqrt();
        format!(
            "{:.2} ({:.2}/{:.2})",
            self.nees / self.count,
            per_axis(self.square_deg),
            per_axis(self.variance_deg)
        )
    }
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<(), String> {
    let (mut seeds, mut names, mut overrides) = (5u64, Vec::new(), Vec::new());
    for argument in std::env::args().skip(1) {
        match argument.split_once('=') {
            Some(("seeds", n)) => seeds = n.parse().map_err(|e| format!("seeds={n}: {e}"))?,
            Some(("scenario", name)) => names.push(name.to_owned()),
            Some(_) => overrides.push(argument),
            None => return Err(format!("{argument}: want key=value")),
        }
    }
    let folder = Path::new("scenarios");
    if names.is_empty() {
        let entries = std::fs::read_dir(folder).map_err(|e| format!("scenarios: {e}"))?;
        names = entries
            .filter_map(|e| e.ok()?.file_name().into_string().ok())
            .filter_map(|name| name.strip_suffix(".toml").map(str::to_owned))
            .collect();
        names.sort();
    }
    println!("NEES per degree of freedom (error / claim per axis, deg)");
    println!("| scenario | estimator | all | contact | slide | hold |");
    println!("|---|---|---|---|---|---|");
    for name in names {
        let mut tallies = [[Tally::default(); 3]; 4];
        for seed in 1..=seeds {
            let mut all = overrides.clone();
            all.push(format!("seed={seed}"));
            all.push(format!("task.estimators={ESTIMATORS:?}"));
            let file = folder.join(format!("{name}.toml"));
            let text = std::fs::read_to_string(&file).map_err(|e| format!("{name}: {e}"))?;
            let read = |n: &str| std::fs::read_to_string(folder.join(n)).map_err(|e| e.to_string());
            let scenario = Scenario::parse(&name, &text, &all, &read).map_err(|e| e.to_string())?;
            evaluate_with(&scenario, |cycle| {
                let phase = match cycle.output.phase {
                    Phase::Contact => 0,
                    Phase::Slide => 1,
                    Phase::Hold => 2,
                    _ => return,
                };
                if !cycle.truth.in_contact {
                    return;
                }
                for (tally, estimate) in tallies.iter_mut().zip(cycle.estimates) {
                    let Some(e) = estimate.filter(|e| e.validity.is_valid()) else {
                        continue;
                    };
                    let Some(nees) = nees_of_normal(&e.normal, &e.covariance, &cycle.truth.normal)
                    else {
                        continue;
                    };
                    tally[phase].merge(&Tally {
                        nees,
                        square_deg: angle_deg(&e.normal, &cycle.truth.normal).powi(2),
                        variance_deg: e.covariance.trace() * 1f64.to_degrees().powi(2),
                        count: 1.0,
                    });
                }
            })
            .map_err(|e| e.to_string())?;
        }
        for (estimator, phases) in ESTIMATORS.iter().zip(&tallies) {
            let mut all = Tally::default();
            phases.iter().for_each(|p| all.merge(p));
            let cells = phases.iter().map(Tally::text).collect::<Vec<_>>();
            println!(
                "| `{name}` | `{estimator}` | {} | {} |",
                all.text(),
                cells.join(" | ")
            );
        }
    }
    let _ = PHASES;
    Ok(())
}
