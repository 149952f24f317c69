//! The figures of `tangent reproduce lippiello`, without a build of the network.
//!
//! ```sh
//! cargo run --release -p tangent-simulation --example lippiello -- \
//!     [seeds=20] [json] [key=value…]
//! ```
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::error::Error;
use std::process::ExitCode;
use std::time::Instant;

use tangent_simulation::lippiello::{Runs, SCENARIO, System, figures};
use tangent_simulation::{ObjectScenario, evaluate_object};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let (mut seeds, mut json, mut overrides) = (20_u64, false, Vec::new());
    for argument in std::env::args().skip(1) {
        match argument.split_once('=') {
            Some(("seeds", n)) => seeds = n.parse()?,
            Some(_) => overrides.push(argument),
            None if argument == "json" => json = true,
            None => return Err(format!("{argument}: want json or key=value").into()),
        }
    }
    let text = include_str!("../../../scenarios/lippiello/lippiello_plane.toml");
    let mut all = Vec::new();
    for system in System::ALL {
        let mut runs = Vec::new();
        for seed in 1..=seeds {
            let mut set = system.overrides();
            set.extend(overrides.clone());
            set.push(format!("seed={seed}"));
            let scenario = ObjectScenario::parse(SCENARIO, text, &set)?;
            let start = Instant::now();
            let evaluation = evaluate_object(&scenario)?;
            let evaluation = evaluation.with_wall_time(start.elapsed().as_secs_f64());
            if evaluation.phase != "done" {
                eprintln!("{}, seed {seed}: {:?}", system.name(), evaluation.fault);
            }
            runs.push(evaluation);
        }
        all.push(Runs { system, runs });
    }
    let rows = figures(&all);
    if json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
        return Ok(());
    }
    println!("| system | figure | median | worst | goal | |");
    println!("|---|---|---|---|---|---|");
    let number = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{x:.4}"));
    for r in rows {
        let met = match r.met {
            Some(true) => "met",
            Some(false) => "NOT MET",
            None => "",
        };
        println!(
            "| {} | {} | {} {} | {} | {} | {met} |",
            r.row,
            r.metric,
            number(r.here),
            r.unit,
            number(r.worst),
            number(r.goal)
        );
    }
    Ok(())
}
