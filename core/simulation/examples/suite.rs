//! `tangent evaluate --suite contact` without building the network: prints the tables and, for
//! each surface, the worst draw. With `--draw K` and `--surface NAME`, prints one draw, and with
//! `--trace N` every Nth cycle of it. `--set key=value` changes a value in every draw.
//!
//! ```sh
//! cargo run --release -p tangent-simulation --example suite -- --draws 5 --seed 1 --surface pipe
//! cargo run --release -p tangent-simulation --example suite -- --surface pipe --draw 3 --trace 25
//! ```
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::error::Error;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use tangent_simulation::evaluate_admittance_with;
use tangent_simulation::suite::{Judgement, SuiteReport, SurfaceKind, draw, run};

fn main() -> Result<(), Box<dyn Error>> {
    let (mut draws, mut seed, mut trace, mut one) = (5_u64, 1_u64, None, None);
    let mut threads = std::thread::available_parallelism().map_or(1, usize::from);
    let (mut surfaces, mut csv) = (SurfaceKind::ALL.to_vec(), None);
    let mut overrides = Vec::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(key) = arguments.next() {
        let value = arguments.next().ok_or("every option has a value")?;
        match key.as_str() {
            "--draws" => draws = value.parse()?,
            "--seed" => seed = value.parse()?,
            "--draw" => one = Some(value.parse()?),
            "--trace" => trace = Some(value.parse()?),
            "--threads" => threads = value.parse()?,
            "--set" => overrides.push(value),
            "--csv" => csv = Some(value),
            "--surface" => {
                surfaces = vec![SurfaceKind::from_name(&value).ok_or("no such surface")?];
            }
            _ => return Err(format!("unknown option {key}").into()),
        }
    }
    if let Some(number) = one {
        return show(surfaces[0], number, seed, &overrides, trace);
    }
    let all: Vec<(SurfaceKind, u64)> = surfaces
        .iter()
        .flat_map(|&surface| (0..draws).map(move |number| (surface, number)))
        .collect();
    let (start, next) = (Instant::now(), AtomicUsize::new(0));
    let work = || -> Result<Vec<Judgement>, String> {
        let mut done = Vec::new();
        while let Some(&(surface, number)) = all.get(next.fetch_add(1, Ordering::Relaxed)) {
            let of = |e: &dyn std::fmt::Display| format!("{} {number}: {e}", surface.name());
            let draw = draw(surface, number, seed).with_overrides(&overrides);
            done.push(draw.and_then(|draw| run(&draw)).map_err(|e| of(&e))?);
        }
        Ok(done)
    };
    let runs = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let mut runs = Vec::new();
        for worker in workers {
            runs.extend(worker.join().map_err(|_| "a run panicked".to_owned())??);
        }
        Ok::<_, String>(runs)
    })?;
    let report = SuiteReport::of(draws, seed, runs).with_wall_time(start.elapsed().as_secs_f64());
    print!("{report}");
    println!(
        "{:.0} s, {:.0} x real time, digest {}",
        report.wall_s.unwrap_or_default(),
        report.real_time_factor.unwrap_or_default(),
        &report.digest[..16]
    );
    for row in &report.rows {
        println!("{}", row.figures.worst);
    }
    for run in report.runs.iter().filter(|run| !run.completed) {
        let end = run.fault.as_deref().unwrap_or(run.phase);
        println!(
            "not completed: {} {}: {end}",
            run.surface.name(),
            run.number
        );
    }
    if let Some(file) = csv {
        std::fs::write(file, report.csv())?;
    }
    Ok(())
}

fn show(
    surface: SurfaceKind,
    number: u64,
    seed: u64,
    overrides: &[String],
    trace: Option<usize>,
) -> Result<(), Box<dyn Error>> {
    let draw = draw(surface, number, seed).with_overrides(overrides)?;
    println!("{draw}");
    println!("{:#?}", draw.scenario.plant);
    println!("{:#?}", draw.scenario.task);
    let mut cycle = 0;
    let evaluation = evaluate_admittance_with(&draw.scenario, |c| {
        if trace.is_some_and(|every| cycle % every == 0) {
            println!("{c}");
        }
        cycle += 1;
    })?;
    println!("{}", serde_json::to_string_pretty(&evaluation)?);
    Ok(())
}
