//! Lippiello et al.: section V over seeds of calibration error, and the paper's four figures.

use std::path::Path;

use anyhow::{Result, anyhow};
use tangent_simulation::lippiello::{Runs, SCENARIO, System, figures};
use tangent_simulation::metrics::object_pose::ObjectSampleTruth;
use tangent_simulation::{Undisturbed, evaluate_object_with};

use super::page::FigurePage;
use super::{Row, progress};
use crate::evaluate::once;
use crate::output::bad_usage;
use crate::report::object::draw_all;
use crate::report::plot::Axes;
use crate::scenarios;

/// Runs all four systems over the seeds.
///
/// # Errors
/// When the scenario cannot be run.
pub(super) fn rows(seeds: u64) -> Result<Vec<Row>> {
    let bar = progress(System::ALL.len() as u64 * seeds);
    let mut all = Vec::new();
    for system in System::ALL {
        bar.set_message(system.name());
        let mut runs = Vec::new();
        for seed in 1..=seeds {
            let mut set = system.overrides();
            set.push(format!("seed={seed}"));
            runs.push(once(SCENARIO, &set)?);
            bar.inc(1);
        }
        all.push(Runs { system, runs });
    }
    bar.finish_and_clear();
    Ok(figures(&all)
        .into_iter()
        .map(|figure| Row {
            table: "Section V (plane of 10 kN/m, camera calibration wrong by seed)",
            row: figure.row,
            metric: figure.metric,
            unit: figure.unit,
            // The paper draws its results and prints no numbers.
            published: None,
            here: figure.here,
            worst: figure.worst,
            goal: figure.goal,
            met: figure.met,
        })
        .collect())
}

/// Figures 1 to 4 of the paper, and the same of the default system, for seed 1.
///
/// # Errors
/// When a file cannot be written.
pub(super) fn draw(folder: &Path) -> Result<()> {
    let mut page = FigurePage::new(
        folder,
        "lippiello",
        "Lippiello et al., section V",
        "The paper's figures: error of the estimated pose, force and moment at the wrist, over time. Touching begins where the \
         force rises. First the published system with the camera alone and with everything, then ours.",
    )?;
    for system in System::ALL {
        let scenario = scenarios::load_object(SCENARIO, &system.overrides())?
            .ok_or_else(|| anyhow!("{SCENARIO} is not of kind object_pose"))?;
        let mut samples: Vec<ObjectSampleTruth> = Vec::new();
        evaluate_object_with(&scenario, &mut Undisturbed, |c| samples.push(*c.sample))
            .map_err(bad_usage)?;
        let stem = match system {
            System::PaperVision => "paper_vision",
            System::PaperAll => "paper_all",
            System::OursVision => "default_vision",
            System::OursAll => "default_all",
        };
        page.system(system.name());
        draw_all(&samples, |(kind, title, unit, _), curves| {
            page.figure(
                &format!("{stem}_{kind}"),
                &Axes {
                    title: &format!("{title}: {}", system.name()),
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
