//! Karacan et al.: section IV over seeds, the duration of the law's step, and the paper's figures 2
//! and 3.

use std::num::NonZero;
use std::path::Path;
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result};
use tangent_simulated_cell::scenarios;
use tangent_simulation::metrics::visuo_tactile::VisuoTactileSample;
use tangent_simulation::systems::visuo_tactile::reproduction::{
    Runs, Variant, figures, replay, step_inputs,
};
use tangent_simulation::{Undisturbed, VisuoTactileScenario, evaluate_visuo_tactile_with};

use super::page::FigurePage;
use super::shortfall::Unfinished;
use super::{Found, over_seeds, progress};
use crate::output::bad_usage;
use crate::report::plot::Axes;
use crate::report::tactile::draw_all;

/// Runs all variants over the seeds, with one run per core at the same time.
///
/// # Errors
/// A scenario cannot be run.
pub(super) fn run(seeds: u64) -> Result<Found> {
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    let bar = progress(Variant::ALL.len() as u64 * seeds);
    let (mut all, mut unfinished) = (Vec::new(), Vec::new());
    for variant in Variant::ALL {
        bar.set_message(variant.name());
        let runs = over_seeds(variant.scenario(), &variant.overrides(), seeds, cores, &bar)?;
        let step_us = if variant.draws() {
            // The law is identical to the variant without images.
            None
        } else {
            Some(step_us(variant)?)
        };
        unfinished.extend(Unfinished::among(variant.name(), &runs));
        all.push(Runs {
            variant,
            runs,
            step_us,
        });
    }
    bar.finish_and_clear();
    Ok(Found {
        rows: figures(&all),
        unfinished,
        ..Found::default()
    })
}

fn scenario(variant: Variant) -> Result<VisuoTactileScenario> {
    let name = variant.scenario();
    scenarios::load(name, &variant.overrides())?
        .into_visuo_tactile()
        .with_context(|| format!("{name} is not of kind visuo_tactile"))
}

/// Median and 99th percentile of the duration of the law's step over a whole run, µs.
fn step_us(variant: Variant) -> Result<[f64; 2]> {
    let scenario = scenario(variant)?;
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

/// Draws figure 2 (the surface touched) and figures 3 a to d (shaping functions, motion, force,
/// tanks) of both presets, for seed 1.
///
/// # Errors
/// A file cannot be written.
pub(super) fn draw(folder: &Path) -> Result<()> {
    let mut page = FigurePage::new(
        folder,
        "karacan",
        "Karacan et al., figures 2 and 3",
        "The touched surface, the shaping functions, desired and actual motion, force and tank energies: first with the \
         published parameters, then with the default ones.",
    )?;
    for (variant, stem) in [
        (Variant::Paper, "karacan_paper"),
        (Variant::Ours, "karacan_default"),
    ] {
        let scenario = scenario(variant)?;
        let mut samples: Vec<VisuoTactileSample> = Vec::new();
        evaluate_visuo_tactile_with(&scenario, &mut Undisturbed, |c| samples.push(*c.sample))
            .map_err(bad_usage)?;
        page.system(variant.name());
        draw_all(&samples, |plot, curves| {
            page.figure(
                &format!("{stem}_{}", plot.kind),
                &Axes {
                    title: &format!("{}: {}", plot.title, variant.name()),
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
