//! Consistency of the estimators' covariances: mean of the normalised squared error per scenario,
//! estimator and phase.
//!
//! ```sh
//! cargo run --release -p tangent-simulation --example nees -- \
//!     [seeds=5] [scenario=NAME…] [key=value…]
//! ```
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

#[path = "../tests/integration/nees/mod.rs"]
mod nees;

use nees::{ESTIMATORS, Phases, Tally, measure};
use tangent_simulation::{AdmittanceScenario, FileError};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let (mut seeds, mut names, mut overrides) = (5u64, Vec::new(), Vec::new());
    for argument in std::env::args().skip(1) {
        match argument.split_once('=') {
            Some(("seeds", n)) => seeds = n.parse().map_err(|e| format!("seeds={n}: {e}"))?,
            Some(("scenario", name)) => names.push(name.to_owned()),
            Some(_) => overrides.push(argument),
            None => return Err(format!("{argument}: want key=value").into()),
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
        let mut sums = [Phases::default(); 4];
        for seed in 1..=seeds {
            let mut all = overrides.clone();
            all.push(format!("seed={seed}"));
            all.push(format!("task.estimators={ESTIMATORS:?}"));
            let file = folder.join(format!("{name}.toml"));
            let text = std::fs::read_to_string(&file).map_err(|e| format!("{name}: {e}"))?;
            let read = |n: &str| std::fs::read_to_string(folder.join(n)).map_err(FileError::new);
            let scenario = AdmittanceScenario::parse(&name, &text, &all, &read)?;
            let found = measure(&scenario)?;
            for (sum, part) in sums.iter_mut().zip(&found) {
                sum.merge(part);
            }
        }
        for (estimator, phases) in ESTIMATORS.iter().zip(&sums) {
            let cells: Vec<String> = phases.0.iter().map(Tally::text).collect();
            println!(
                "| `{name}` | `{estimator}` | {} | {} |",
                phases.all().text(),
                cells.join(" | ")
            );
        }
    }
    Ok(())
}
