//! Karacan et al.: section IV over seeds, the time of the law's step, and the paper's figures 2 and
//! 3.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use anyhow::{Result, anyhow};
use indicatif::ProgressBar;
use tangent_simulation::karacan::{Runs, System, figures, replay, step_inputs};
use tangent_simulation::metrics::tactile::TactileSample;
use tangent_simulation::{Calm, Evaluation, evaluate_tactile_with};

use super::page::FigurePage;
use super::{Row, progress};
use crate::evaluate::once;
use crate::output::bad_usage;
use crate::report::plot::Axes;
use crate::report::tactile::draw_all;
use crate::scenarios;

/// Runs all systems over the seeds.
///
/// # Errors
/// When a scenario cannot be run.
pub(super) fn rows(seeds: u64) -> Result<Vec<Row>> {
    let bar = progress(System::ALL.len() as u64 * seeds);
    let mut all = Vec::new();
    for system in System::ALL {
        bar.set_message(system.name());
        let runs = over_seeds(system, seeds, &bar)?;
        let step_us = if system.draws() {
            // The same law as without the images.
            None
        } else {
            Some(step_us(system)?)
        };
        all.push(Runs {
            system,
            runs,
            step_us,
        });
    }
    bar.finish_and_clear();
    Ok(figures(&all)
        .into_iter()
        .map(|figure| Row {
            table: "Section IV (wiping the wave with 15 N for 20 s)",
            row: figure.row.to_owned(),
            metric: figure.metric,
            unit: figure.unit,
            published: figure.published,
            here: figure.here,
            worst: figure.worst,
            goal: figure.goal,
            met: figure.met,
        })
        .collect())
}

/// One run per seed, as many at a time as there are cores, in the order of the seeds.
fn over_seeds(system: System, seeds: u64, bar: &ProgressBar) -> Result<Vec<Evaluation>> {
    let next = AtomicU64::new(1);
    let done = Mutex::new(BTreeMap::new());
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed > seeds {
                return;
            }
            let mut set = system.overrides();
            set.push(format!("seed={seed}"));
            let run = once(system.scenario(), &set);
            done.lock()
                .unwrap_or_else(PoisonError::into_inner)
                .insert(seed, run);
            bar.inc(1);
        }
    };
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(work);
        }
    });
    let done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.into_values().collect()
}

/// Median and 99th percentile of a step of the law over a whole run, µs.
fn step_us(system: System) -> Result<[f64; 2]> {
    let scenario = scenarios::load_tactile(system.scenario(), &system.overrides())?
        .ok_or_else(|| anyhow!("{} is not of kind visuo_tactile", system.scenario()))?;
    let inputs = step_inputs(&scenario).map_err(bad_usage)?;
    let mut times = Vec::with_capacity(inputs.len());
    replay(&scenario, &inputs, |step| {
        let start = Instant::now();
        step();
        times.push(start.elapsed().as_secs_f64() * 1e6);
    })
    .map_err(bad_usage)?;
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    Ok([at(0.5), at(0.99)])
}

/// Figure 2 (the surface touched) and figure 3 a to d (shaping functions, motion, force, tanks) of
/// both presets, for seed 1.
///
/// # Errors
/// When a file cannot be written.
pub(super) fn draw(folder: &Path) -> Result<()> {
    let mut page = FigurePage::new(
        folder,
        "karacan",
        "Karacan et al., figures 2 and 3",
        "The surface touched, the shaping functions, desired and actual motion, force and tank energies: first with the \
         published parameters, then with ours.",
    )?;
    for (system, stem) in [
        (System::Paper, "karacan_paper"),
        (System::Ours, "karacan_default"),
    ] {
        let scenario = scenarios::load_tactile(system.scenario(), &system.overrides())?
            .ok_or_else(|| anyhow!("{} is not of kind visuo_tactile", system.scenario()))?;
        let mut samples: Vec<TactileSample> = Vec::new();
        evaluate_tactile_with(&scenario, &mut Calm, |c| samples.push(*c.sample))
            .map_err(bad_usage)?;
        page.system(system.name());
        draw_all(&samples, |plot, curves| {
            page.figure(
                &format!("{stem}_{}", plot.kind),
                &Axes {
                    title: &format!("{}: {}", plot.title, system.name()),
                    x: plot.x,
                    y: plot.y,
                    equal: plot.equal,
                    reference: None,
                    bands: &[],
                },
                curves,
            )
        })?;
    }
    page.finish()
}
