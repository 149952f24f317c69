//! `tangent evaluate` without a build of the network: a scenario file's figures, and with `trace=N` every Nth cycle.
//!
//! `cargo run --release -p tangent-simulation --example evaluate -- scenarios/pipe_ideal.toml seed=2 trace=25`
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use tangent_simulation::{Scenario, evaluate_with};

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
    let mut arguments = std::env::args().skip(1);
    let file = arguments
        .next()
        .ok_or("usage: evaluate SCENARIO [key=value…] [trace=N]")?;
    let (trace, overrides): (Vec<String>, Vec<String>) =
        arguments.partition(|a| a.starts_with("trace="));
    let every: Option<usize> = match trace.last() {
        Some(text) => Some(text["trace=".len()..].parse()?),
        None => None,
    };
    let text = std::fs::read_to_string(&file).map_err(|e| format!("{file}: {e}"))?;
    let folder = Path::new(&file).parent().unwrap_or(Path::new("."));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).map_err(|e| e.to_string());
    let scenario = Scenario::parse(&file, &text, &overrides, &read)?;

    let (mut cycle, mut lines) = (0_usize, Vec::new());
    let start = Instant::now();
    let evaluation = evaluate_with(&scenario, |c| {
        if every.is_some_and(|n| n > 0 && cycle.is_multiple_of(n)) {
            lines.push(c.to_string());
        }
        cycle += 1;
    })?
    .with_wall_time(start.elapsed().as_secs_f64());
    println!("{}", serde_json::to_string_pretty(&evaluation)?);
    for line in lines {
        println!("{line}");
    }
    Ok(())
}
