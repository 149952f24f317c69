//! Lippiello et al.: section V over seeds of calibration error, and the paper's four figures.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use plotters::style::RGBColor;
use tangent_simulation::lippiello::{Runs, SCENARIO, System, figures};
use tangent_simulation::metrics::object_pose::{ObjectSampleTruth, pose_error};
use tangent_simulation::{Undisturbed, evaluate_object_with};

use super::{Row, progress};
use crate::evaluate::once;
use crate::output::bad_usage;
use crate::report::plot::{Axes, BLUE, GREEN, ORANGE, Series, draw as draw_plot};
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
    fs::create_dir_all(folder).with_context(|| format!("folder {}", folder.display()))?;
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
        for (kind, title, unit, pick) in curves() {
            let axes: Vec<Vec<(f64, f64)>> = (0..3)
                .map(|i| {
                    let value = |s: &ObjectSampleTruth| pick(s).map_or(f64::NAN, |v| v[i]);
                    samples.iter().map(|s| (s.time_s, value(s))).collect()
                })
                .collect();
            let colours: [RGBColor; 3] = [BLUE, GREEN, ORANGE];
            let series: Vec<Series<'_>> = ["x", "y", "z"]
                .iter()
                .zip(&axes)
                .zip(colours)
                .map(|((&name, points), colour)| Series {
                    name,
                    points,
                    colour,
                })
                .collect();
            let svg = draw_plot(
                &Axes {
                    title: &format!("{title}: {}", system.name()),
                    x: "time, s",
                    y: unit,
                    equal: false,
                    reference: None,
                    bands: &[],
                },
                &series,
            )?;
            let file = folder.join(format!("{stem}_{kind}.svg"));
            fs::write(&file, svg).with_context(|| format!("file {}", file.display()))?;
        }
    }
    Ok(())
}

/// Three components at one time; none where there is no estimate.
type Pick = fn(&ObjectSampleTruth) -> Option<[f64; 3]>;

fn curves() -> [(&'static str, &'static str, &'static str, Pick); 4] {
    [
        ("position", "Position error in object axes", "m", |s| {
            Some(pose_error(&s.object, s.estimated.as_ref()?).0.into())
        }),
        (
            "orientation",
            "Orientation error in object axes",
            "deg",
            |s| {
                let turn = pose_error(&s.object, s.estimated.as_ref()?).1;
                Some(turn.map(f64::to_degrees).into())
            },
        ),
        ("force", "Force at the wrist", "N", |s| {
            Some(s.sensor.0.into())
        }),
        ("moment", "Moment at the wrist", "Nm", |s| {
            Some(s.sensor.1.into())
        }),
    ]
}
