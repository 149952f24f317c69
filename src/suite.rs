//! `tangent evaluate --suite`: random cells and tasks on all cores, and the tables of what became
//! of them.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result};
use tangent_simulation::suite::{self, Judgement, SuiteReport, SurfaceKind};

use crate::cli::Evaluate;
use crate::evaluate::{overrides, show};
use crate::output::{Outcome, bad_usage, print_json};
use crate::terminal;

/// Runs the suite, or one draw of it. The overrides of the command line apply to every draw.
///
/// # Errors
/// An override is not usable, or a file cannot be written.
pub fn run(args: &Evaluate, json: bool) -> Result<Outcome> {
    let overrides = &overrides(args);
    let (options, seed) = (&args.suite, args.seed.unwrap_or(1));
    if let (Some(surface), Some(number)) = (options.surface, options.draw) {
        return one(surface, number, seed, overrides, json);
    }
    let surfaces = options
        .surface
        .map_or_else(|| SurfaceKind::ALL.to_vec(), |surface| vec![surface]);
    let (part, parts) = options.shard.unwrap_or((1, 1));
    let draws: Vec<(SurfaceKind, u64)> = surfaces
        .iter()
        .flat_map(|&surface| (0..options.draws).map(move |number| (surface, number)))
        .filter(|(_, number)| number % parts == part - 1)
        .collect();
    let start = Instant::now();
    let runs = all(&draws, seed, overrides)?;
    let report =
        SuiteReport::of(options.draws, seed, runs).with_wall_time(start.elapsed().as_secs_f64());
    write(options.csv.as_deref(), || report.csv())?;
    write(options.html.as_deref(), || report.html())?;
    if json {
        print_json(&report)?;
    } else {
        print(&report);
    }
    Ok(Outcome::Done)
}

fn one(
    surface: SurfaceKind,
    number: u64,
    seed: u64,
    overrides: &[String],
    json: bool,
) -> Result<Outcome> {
    let draw = suite::draw(surface, number, seed)
        .with_overrides(overrides)
        .map_err(bad_usage)?;
    let start = Instant::now();
    let evaluation = tangent_simulation::evaluate_admittance(&draw.scenario).map_err(bad_usage)?;
    if !json {
        println!("{draw}");
    }
    show(
        &evaluation.with_wall_time(start.elapsed().as_secs_f64()),
        json,
    )
}

/// Runs all draws, on all cores; the order of the results is not defined.
///
/// # Errors
/// An override is not usable.
fn all(draws: &[(SurfaceKind, u64)], seed: u64, overrides: &[String]) -> Result<Vec<Judgement>> {
    let bar = terminal::bar(
        draws.len() as u64,
        "{bar:20} {pos}/{len} draws  {eta} left  {wide_msg}",
    );
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Ok(Vec::with_capacity(draws.len())));
    let work = || {
        while let Some(&(surface, number)) = draws.get(next.fetch_add(1, Ordering::Relaxed)) {
            let run = suite::draw(surface, number, seed)
                .with_overrides(overrides)
                .and_then(|draw| suite::run(&draw));
            let mut results = results
                .lock()
                .expect("no thread panics while it holds this");
            match (&mut *results, run) {
                (Ok(runs), Ok(run)) => runs.push(run),
                (Ok(_), Err(error)) => {
                    *results = Err(bad_usage(error));
                    return;
                }
                (Err(_), _) => return,
            }
            drop(results);
            bar.set_message(surface.name());
            bar.inc(1);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, NonZeroUsize::get) {
            scope.spawn(work);
        }
    });
    bar.finish_and_clear();
    results
        .into_inner()
        .expect("no thread panics while it holds this")
}

fn write(file: Option<&Path>, text: impl FnOnce() -> String) -> Result<()> {
    let Some(file) = file else {
        return Ok(());
    };
    std::fs::write(file, text()).with_context(|| format!("cannot write {}", file.display()))
}

fn print(report: &SuiteReport) {
    print!("{report}");
    println!(
        "{:.1} s, {:.0} x real time, digest {}",
        report.wall_s.unwrap_or_default(),
        report.real_time_factor.unwrap_or_default(),
        &report.digest[..16]
    );
    println!("worst draws:");
    for row in &report.rows {
        println!("  {}", row.figures.worst);
    }
}
