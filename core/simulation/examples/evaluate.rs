//! Runs one scenario file in the closed loop and prints its figures; with `trace=N`, also every Nth cycle.
//!
//! `cargo run --release -p tangent-simulation --example evaluate -- scenarios/pipe_ideal.toml seed=2 trace=25`
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use tangent_simulation::metrics::angle_deg;
use tangent_simulation::{LoopCycle, Scenario, evaluate, evaluate_with};

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
    let mut arguments = std::env::args().skip(1);
    let file = arguments
        .next()
        .ok_or("usage: evaluate SCENARIO [key=value…] [trace=N]")?;
    let (trace, overrides): (Vec<String>, Vec<String>) =
        arguments.partition(|a| a.starts_with("trace="));
    let text = std::fs::read_to_string(&file).map_err(|e| format!("{file}: {e}"))?;
    let folder = Path::new(&file).parent().unwrap_or(Path::new("."));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).map_err(|e| e.to_string());
    let scenario = Scenario::parse(&file, &text, &overrides, &read).map_err(|e| e.to_string())?;

    let start = Instant::now();
    let evaluation = evaluate(&scenario).map_err(|e| e.to_string())?;
    let evaluation = evaluation.with_wall_time(start.elapsed().as_secs_f64());
    println!(
        "{}",
        serde_json::to_string_pretty(&evaluation).map_err(|e| e.to_string())?
    );

    let every = trace
        .last()
        .and_then(|t| t["trace=".len()..].parse::<usize>().ok());
    if let Some(every) = every.filter(|n| *n > 0) {
        let mut cycle = 0;
        evaluate_with(&scenario, |c| {
            if cycle % every == 0 {
                println!("{}", line(c));
            }
            cycle += 1;
        })
        .map_err(|e| e.to_string())?;
    }
    Ok(())
}

fn line(c: &LoopCycle<'_>) -> String {
    let truth = c.truth;
    let normal_error = c
        .estimate
        .map_or(f64::NAN, |e| angle_deg(&e.normal, &truth.normal));
    let along = |v: &nalgebra::Vector3<f64>| v.dot(&truth.normal) * 1e3;
    format!(
        "{:7.3} s {:8} force {:6.3} true {:6.3} measured {:5.2} wanted N | normal {:6.2} tool {:6.2} deg | {:6.2} mm/s sliding, \
         normal {:6.2} wanted {:6.2} real mm/s | path {:6.3} mm | d {:5.0} Ns/m k {:6.0} N/m | wrench {:.2?} N | {}",
        c.arm.time_s,
        c.output.phase.name(),
        truth.wrench.force.dot(&truth.normal),
        c.output.force_n,
        c.output.force_reference_n,
        normal_error,
        angle_deg(&truth.normal, &-truth.base_from_tool.z_axis()),
        truth.sliding_speed_m_per_s * 1e3,
        along(&c.output.twist_commanded.linear),
        along(&c.input.twist.linear),
        c.output.path_error_m * 1e3,
        c.output.damping_n_s_per_m,
        c.output.stiffness_n_per_m,
        c.input.wrench.force.as_slice(),
        c.estimate.map_or("no estimate", |e| e.validity.reason()),
    )
}
