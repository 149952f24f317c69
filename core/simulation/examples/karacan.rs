//! Figures of the `karacan` system, without a build of the network.
//!
//! `cargo run --release -p tangent-simulation --example karacan -- [seeds=10] [trace] [key=value…]`
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::error::Error;
use std::process::ExitCode;
use std::time::Instant;

use tangent_simulation::{Calm, TactileScenario, evaluate_tactile_with};

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
    let (mut seeds, mut trace, mut overrides) = (10_u64, false, Vec::new());
    for argument in std::env::args().skip(1) {
        match argument.split_once('=') {
            Some(("seeds", n)) => seeds = n.parse()?,
            Some(_) => overrides.push(argument),
            None if argument == "trace" => trace = true,
            None => return Err(format!("{argument}: want trace or key=value").into()),
        }
    }
    let text = include_str!("../../../scenarios/karacan/karacan_wave.toml");
    println!(
        "seed phase force_mad rmse peak path_mad x y z rmse x y z motion force tool_deg rho slide_s wall_s"
    );
    for seed in 1..=seeds {
        let mut set = overrides.clone();
        set.push(format!("seed={seed}"));
        let scenario = TactileScenario::parse("karacan_wave", text, &set)?;
        let start = Instant::now();
        let mut next = 0.0;
        let e = evaluate_tactile_with(&scenario, &mut Calm, |c| {
            if trace && c.input.time_s >= next {
                next += 0.25;
                let (s, o, inside) = (c.sample, c.output, c.sample.inside);
                println!(
                    "{:6.2} {:9} C {:.2}/{:.2} rho {:.2} {:.2} F {:6.2} of {:5.2} (felt {:6.2}) d {:6.2} {:6.2} {:6.2} mm err n {:.1} tool {:.1} deg S {:.2} {:.2} short {:.1e} mu {:.2} {}",
                    s.time_s,
                    s.phase.name(),
                    s.monitor.0,
                    s.monitor.1,
                    s.rho_align,
                    s.rho_force,
                    c.truth.wrench.force.dot(&c.truth.normal),
                    s.force_reference_n,
                    o.force_n.unwrap_or(f64::NAN),
                    (s.tool_m[0] - s.wanted_m[0]) * 1e3,
                    (s.tool_m[1] - s.wanted_m[1]) * 1e3,
                    (s.tool_m[2] - s.wanted_m[2]) * 1e3,
                    o.normal.angle(&c.truth.normal).to_degrees(),
                    c.truth
                        .base_from_tool
                        .z_axis()
                        .angle(&-c.truth.normal)
                        .to_degrees(),
                    s.tanks_j.0,
                    s.tanks_j.1,
                    inside.map_or(f64::NAN, |i| i.short_j),
                    inside.map_or(f64::NAN, |i| i.friction),
                    if inside.is_some_and(|i| i.limited) {
                        "limited"
                    } else {
                        ""
                    }
                );
            }
        })?;
        let wall = start.elapsed().as_secs_f64();
        let (f, p) = (e.figures.force, e.figures.path);
        let or = |x: Option<f64>| x.unwrap_or(f64::NAN);
        let mm = |x: Option<[f64; 3]>| x.unwrap_or([f64::NAN; 3]).map(|v| v * 1e3);
        let t = e.tactile.unwrap_or_default();
        let tanks = e.figures.tanks;
        println!(
            "{seed} {} {:.2} {:.2} {:.1} | {:.2?} | {:.2?} | {:.2?} | tool {:.2} est {:.2} | rho {:.2} {:.2} frc {:.2} share {:.2} lost {} lim {} | {:.1} s {:.1} s {}",
            e.phase,
            or(f.mad_n),
            or(f.rmse_n),
            or(f.peak_n),
            mm(p.mad_xyz_m),
            mm(p.rmse_xyz_m),
            tanks.map(|t| [
                or(t.motion_min_j),
                or(t.motion_max_j),
                t.force_min_j,
                t.force_max_j,
            ]),
            e.figures.tool_error_deg.map_or(f64::NAN, |s| s.mean),
            e.figures.normal_error_deg.map_or(f64::NAN, |s| s.mean),
            or(t.rho_align_min),
            or(t.rho_align_mean),
            or(t.rho_force_min),
            or(t.monitor_share_max),
            e.figures.contact.lost_count,
            t.limited_cycles.unwrap_or_default(),
            t.sliding_s,
            wall,
            e.fault.unwrap_or("")
        );
    }
    Ok(())
}
