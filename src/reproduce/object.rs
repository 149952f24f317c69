//! Lippiello et al.: section V over seeds of calibration error, and the paper's four figures.

use std::path::Path;

use anyhow::{Context, Result};
use tangent_simulated_cell::scenarios;
use tangent_simulation::metrics::object::ObjectSampleTruth;
use tangent_simulation::systems::object::reproduction::{Runs, SCENARIO, Variant, figures};
use tangent_simulation::{Undisturbed, evaluate_object_with};

use super::page::FigurePage;
use super::shortfall::Unfinished;
use super::{Found, over_seeds, progress};
use crate::output::bad_usage;
use crate::report::object::draw_all;
use crate::report::plot::Axes;

/// Runs all four variants over the seeds, one run at a time, because the duration of a run is a
/// figure.
///
/// # Errors
/// The scenario cannot be run.
pub(super) fn run(seeds: u64) -> Result<Found> {
    let bar = progress(Variant::ALL.len() as u64 * seeds);
    let (mut all, mut unfinished) = (Vec::new(), Vec::new());
    for variant in Variant::ALL {
        bar.set_message(variant.name());
        let runs = over_seeds(SCENARIO, &variant.overrides(), seeds, 1, &bar)?;
        unfinished.extend(Unfinished::among(variant.name(), &runs));
        all.push(Runs { variant, runs });
    }
    bar.finish_and_clear();
    Ok(Found {
        rows: figures(&all),
        unfinished,
        ..Found::default()
    })
}

/// Draws figures 1 to 4 of the paper for its system and for the default system, seed 1.
///
/// # Errors
/// A file cannot be written.
pub(super) fn draw(folder: &Path) -> Result<()> {
    let mut page = FigurePage::new(
        folder,
        "lippiello",
        "Lippiello et al., section V",
        "The paper's figures: error of the estimated pose, force and moment at the wrist, over time. Contact begins where \
         the force rises. First the published system with the camera alone and with all sensors, then the one of this project.",
    )?;
    for variant in Variant::ALL {
        let scenario = scenarios::load(SCENARIO, &variant.overrides())?
            .into_object()
            .with_context(|| format!("{SCENARIO} is not of kind object_pose"))?;
        let mut samples: Vec<ObjectSampleTruth> = Vec::new();
        evaluate_object_with(&scenario, &mut Undisturbed, |c| samples.push(*c.sample))
            .map_err(bad_usage)?;
        let stem = match variant {
            Variant::PaperVision => "paper_vision",
            Variant::PaperAll => "paper_all",
            Variant::OursVision => "default_vision",
            Variant::OursAll => "default_all",
        };
        page.system(variant.name());
        draw_all(&samples, |(kind, title, unit, _), curves| {
            page.figure(
                &format!("{stem}_{kind}"),
                &Axes {
                    title: &format!("{title}: {}", variant.name()),
                    x: "time, s",
                    y: unit,
                    equal: false,
                    reference: None,
                    bands: &[],
                },
                curves,
            )
        })?;
    }
    page.finish()
}
