//! `tangent evaluate` without building the network: prints the figures of a scenario file and, with
//! `trace=N`, every Nth cycle. `passes=N` repeats it N times with what the passes learn.
//!
//! ```sh
//! cargo run --release -p tangent-simulation --example evaluate -- \
//!     scenarios/pipe_ideal.toml seed=2 trace=25
//! ```
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use tangent_simulation::metrics::object::pose_error;
use tangent_simulation::{
    FileError, ObjectCycle, Scenario, Undisturbed, VisuoTactileCycle, evaluate_admittance_passes,
    evaluate_admittance_with, evaluate_object_of, evaluate_visuo_tactile_of, joints_of,
};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}

fn object_line<const N: usize>(c: &ObjectCycle<'_, N>) -> String {
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

fn visuo_tactile_line<const N: usize>(c: &VisuoTactileCycle<'_, N>) -> String {
    let s = c.sample;
    let away = |i: usize| (s.tool_m[i] - s.wanted_m[i]) * 1e3;
    format!(
        "{:7.3} s {:8} force {:7.3} wanted {:6.2} N | path {:6.3} {:6.3} {:6.3} mm | rho {:.2} {:.2} | tanks {:6.2} {:5.2} J",
        s.time_s,
        s.phase.name(),
        c.output.force_n.unwrap_or(f64::NAN),
        s.force_reference_n,
        away(0),
        away(1),
        away(2),
        s.rho_align,
        s.rho_force,
        s.tanks_j.0,
        s.tanks_j.1
    )
}

fn run() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments
        .next()
        .ok_or("usage: evaluate SCENARIO [key=value…] [trace=N]")?;
    let (trace, rest): (Vec<String>, Vec<String>) =
        arguments.partition(|a| a.starts_with("trace="));
    let (passes, overrides): (Vec<String>, Vec<String>) =
        rest.into_iter().partition(|a| a.starts_with("passes="));
    let every: Option<usize> = match trace.last() {
        Some(text) => Some(text["trace=".len()..].parse()?),
        None => None,
    };
    let text = std::fs::read_to_string(&file).map_err(|e| format!("{file}: {e}"))?;
    let folder = Path::new(&file).parent().unwrap_or(Path::new("."));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).map_err(FileError::new);
    if let Some(passes) = passes.last() {
        let passes = passes["passes=".len()..].parse()?;
        let scenario = Scenario::parse(&file, &text, &overrides, &read)?
            .into_admittance()
            .ok_or("passes: only scenarios of the admittance system learn")?;
        for p in evaluate_admittance_passes(&scenario, passes)? {
            let f = &p.evaluation.figures;
            println!(
                "pass {} seed {} {}: force rmse {:.4} N true, {:.4} N measured | peak {:.3} N | normal {:.3} deg | tool {:.3} deg | path {:.2} s | lost {} | weight {:.2}",
                p.pass,
                p.evaluation.seed,
                p.evaluation.phase,
                f.force.rmse_n.unwrap_or(f64::NAN),
                p.force_measured_rmse_n.unwrap_or(f64::NAN),
                f.force.peak_n.unwrap_or(f64::NAN),
                f.normal_error_settled_deg.map_or(f64::NAN, |s| s.mean),
                f.tool_error_deg.map_or(f64::NAN, |s| s.mean),
                p.path_time_s,
                f.contact.lost_count,
                p.memory_weight
            );
        }
        return Ok(());
    }
    let (mut cycle, mut lines) = (0_usize, Vec::new());
    let mut is_shown = || {
        cycle += 1;
        every.is_some_and(|n| n > 0 && (cycle - 1).is_multiple_of(n))
    };
    let start = Instant::now();
    let evaluation = match Scenario::parse(&file, &text, &overrides, &read)? {
        Scenario::Admittance(scenario) => evaluate_admittance_with(&scenario, |c| {
            if is_shown() {
                lines.push(c.to_string());
            }
        })?,
        Scenario::ObjectPose(scenario) if joints_of(&scenario.plant.robot)? == 7 => {
            evaluate_object_of::<7>(&scenario, &mut Undisturbed, |c| {
                if is_shown() {
                    lines.push(object_line(c));
                }
            })?
        }
        Scenario::ObjectPose(scenario) => {
            evaluate_object_of::<6>(&scenario, &mut Undisturbed, |c| {
                if is_shown() {
                    lines.push(object_line(c));
                }
            })?
        }
        Scenario::VisuoTactile(scenario) if joints_of(&scenario.plant.robot)? == 6 => {
            evaluate_visuo_tactile_of::<6>(&scenario, &mut Undisturbed, |c| {
                if is_shown() {
                    lines.push(visuo_tactile_line(c));
                }
            })?
        }
        Scenario::VisuoTactile(scenario) => {
            evaluate_visuo_tactile_of::<7>(&scenario, &mut Undisturbed, |c| {
                if is_shown() {
                    lines.push(visuo_tactile_line(c));
                }
            })?
        }
    }
    .with_wall_time(start.elapsed().as_secs_f64());
    println!("{}", serde_json::to_string_pretty(&evaluation)?);
    for line in lines {
        println!("{line}");
    }
    Ok(())
}
