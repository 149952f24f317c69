//! `tangent evaluate` on a scenario of kind `object_pose`, without a build of the network: its figures, and with `trace=N` every
//! Nth cycle.
//!
//! `cargo run --release -p tangent-simulation --example evaluate_object -- scenarios/lippiello/lippiello_plane.toml seed=2 trace=50`
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::error::Error;
use std::process::ExitCode;
use std::time::Instant;

use tangent_simulation::metrics::object_pose::pose_error;
use tangent_simulation::{ObjectCycle, ObjectScenario, Undisturbed, evaluate_object_with};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}

fn line(c: &ObjectCycle<'_>) -> String {
    let s = c.sample;
    let (p, r) = s
        .estimated
        .map_or((Default::default(), Default::default()), |e| {
            pose_error(&s.object, &e)
        });
    let r = r * 180.0 / std::f64::consts::PI;
    format!(
        "{:7.3} s {:8} force {:7.3} wanted {:6.2} N | lateral {:6.3} N moment {:6.3} Nm | pose error {:7.3} {:7.3} {:7.3} mm {:6.3} {:6.3} {:6.3} deg | path {:6.3} mm | tool {:6.3} deg{}",
        s.time_s,
        c.output.phase.name(),
        s.force_n,
        c.output.force_reference_n,
        s.sensor.0.xy().norm(),
        s.sensor.1.norm(),
        p.x * 1e3,
        p.y * 1e3,
        p.z * 1e3,
        r.x,
        r.y,
        r.z,
        c.output.path_error_m * 1e3,
        c.truth
            .normal
            .angle(&-c.truth.base_from_tool.z_axis())
            .to_degrees(),
        if c.output.limited { " LIMITED" } else { "" }
    )
}

fn run() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments
        .next()
        .ok_or("usage: evaluate_object SCENARIO [key=value…] [trace=N]")?;
    let (trace, overrides): (Vec<String>, Vec<String>) =
        arguments.partition(|a| a.starts_with("trace="));
    let every: Option<usize> = match trace.last() {
        Some(text) => Some(text["trace=".len()..].parse()?),
        None => None,
    };
    let text = std::fs::read_to_string(&file).map_err(|e| format!("{file}: {e}"))?;
    let scenario = ObjectScenario::parse(&file, &text, &overrides)?;
    let mut cycle = 0_usize;
    let start = Instant::now();
    let evaluation = evaluate_object_with(&scenario, &mut Undisturbed, |c| {
        if every.is_some_and(|n| n > 0 && cycle.is_multiple_of(n)) {
            println!("{}", line(c));
        }
        cycle += 1;
    })?
    .with_wall_time(start.elapsed().as_secs_f64());
    println!("{}", serde_json::to_string_pretty(&evaluation)?);
    Ok(())
}
