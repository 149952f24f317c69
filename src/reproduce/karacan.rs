//! Karacan et al.: section IV over seeds, the time of the law's step, and the paper's figures 2 and 3.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use plotters::style::RGBColor;
use tangent_simulation::karacan::{Runs, System, figures, replay, step_inputs};
use tangent_simulation::metrics::tactile::TactileSample;
use tangent_simulation::{Calm, evaluate_tactile_with};

use super::{Row, progress};
use crate::evaluate::once;
use crate::output::bad_usage;
use crate::report::plot::{Axes, BLUE, GREEN, ORANGE, PURPLE, Series, draw as draw_plot};
use crate::scenarios;

/// Runs all systems over the seeds.
///
/// # Errors
/// When a scenario cannot be run.
pub(super) fn rows(seeds: u64) -> Result<Vec<Row>> {
    let total: u64 = System::ALL.iter().map(|s| s.seeds(seeds)).sum();
    let bar = progress(total);
    let mut all = Vec::new();
    for system in System::ALL {
        bar.set_message(system.name());
        let mut runs = Vec::new();
        for seed in 1..=system.seeds(seeds) {
            let mut set = system.overrides();
            set.push(format!("seed={seed}"));
            runs.push(once(system.scenario(), &set)?);
            bar.inc(1);
        }
        let step_us = if system == System::OursDepth {
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

/// Figure 2 (the surface touched) and figure 3 a to d (shaping functions, motion, force, tanks) of both presets, for seed 1.
///
/// # Errors
/// When a file cannot be written.
pub(super) fn draw(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("folder {}", folder.display()))?;
    let mut page = PAGE.to_owned();
    for (system, stem) in [
        (System::Paper, "karacan_paper"),
        (System::Ours, "karacan_default"),
    ] {
        let scenario = scenarios::load_tactile(system.scenario(), &system.overrides())?
            .ok_or_else(|| anyhow!("{} is not of kind visuo_tactile", system.scenario()))?;
        let mut samples: Vec<TactileSample> = Vec::new();
        evaluate_tactile_with(&scenario, &mut Calm, |c| samples.push(*c.sample))
            .map_err(bad_usage)?;
        let _ = writeln!(page, "<h2>{}</h2>", system.name());
        for plot in plots() {
            // Ten points in a second and a half are a curve; sixty thousand are a file too large to open.
            let points: Vec<Vec<(f64, f64)>> = plot
                .curves
                .iter()
                .map(|(_, pick)| samples.iter().step_by(10).map(pick).collect())
                .collect();
            let colours: [RGBColor; 6] = [
                BLUE,
                ORANGE,
                GREEN,
                PURPLE,
                RGBColor(176, 42, 48),
                RGBColor(0, 135, 145),
            ];
            let series: Vec<Series<'_>> = plot
                .curves
                .iter()
                .zip(&points)
                .zip(colours)
                .map(|(((name, _), points), colour)| Series {
                    name,
                    points,
                    colour,
                })
                .collect();
            let svg = draw_plot(
                &Axes {
                    title: &format!("{}: {}", plot.title, system.name()),
                    x: plot.x,
                    y: plot.y,
                    equal: plot.equal,
                    reference: None,
                    bands: &[],
                },
                &series,
            )?;
            let file = folder.join(format!("{stem}_{}.svg", plot.kind));
            fs::write(&file, &svg).with_context(|| format!("file {}", file.display()))?;
            let _ = writeln!(page, "<figure>{svg}</figure>");
        }
    }
    page += "</body></html>\n";
    let file = folder.join("index.html");
    fs::write(&file, page).with_context(|| format!("file {}", file.display()))
}

/// Beginning of the page that shows all figures.
const PAGE: &str = "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>tangent reproduce karacan</title>\
<style>body { font: 15px/1.5 system-ui, sans-serif; max-width: 960px; margin: 2em auto; } figure { margin: 1em 0; } \
svg { width: 100%; height: auto; }</style></head><body>\n<h1>Karacan et al., figures 2 and 3</h1>\n\
<p>The surface touched, the shaping functions, desired and actual motion, force and tank energies: first with the published parameters, \
then with ours.</p>\n";

/// Where a sample stands in a plot.
type Pick = fn(&TactileSample) -> (f64, f64);

struct Plot {
    kind: &'static str,
    title: &'static str,
    x: &'static str,
    y: &'static str,
    equal: bool,
    curves: Vec<(&'static str, Pick)>,
}

/// Only where the policy is followed; elsewhere the line breaks.
fn while_sliding(s: &TactileSample, value: f64) -> f64 {
    if s.phase.is_pressing() {
        value
    } else {
        f64::NAN
    }
}

fn plots() -> Vec<Plot> {
    vec![
        Plot {
            kind: "2_surface",
            title: "The surface touched",
            x: "y, m",
            y: "z, m",
            equal: true,
            curves: vec![
                ("tool", |s| (s.tool_m[1], while_sliding(s, s.tool_m[2]))),
                ("model of the surface", |s| {
                    (s.wanted_m[1], while_sliding(s, s.wanted_m[2]))
                }),
            ],
        },
        Plot {
            kind: "3a_shaping",
            title: "Shaping functions",
            x: "time, s",
            y: "",
            equal: false,
            curves: vec![
                ("rho_align", |s| (s.time_s, s.rho_align)),
                ("rho_frc", |s| (s.time_s, s.rho_force)),
                ("C / C_m", |s| {
                    (s.time_s, (s.monitor.0 / s.monitor.1).min(2.0))
                }),
            ],
        },
        Plot {
            kind: "3b_motion",
            title: "Desired and actual motion",
            x: "time, s",
            y: "m",
            equal: false,
            curves: vec![
                ("x", |s| (s.time_s, s.tool_m[0])),
                ("x desired", |s| (s.time_s, while_sliding(s, s.wanted_m[0]))),
                ("y", |s| (s.time_s, s.tool_m[1])),
                ("y desired", |s| (s.time_s, while_sliding(s, s.wanted_m[1]))),
                ("z", |s| (s.time_s, s.tool_m[2])),
                ("z desired", |s| (s.time_s, while_sliding(s, s.wanted_m[2]))),
            ],
        },
        Plot {
            kind: "3c_force",
            title: "Force in tool axes, as the tool presses",
            x: "time, s",
            y: "N",
            equal: false,
            curves: vec![
                ("z", |s| (s.time_s, -s.force_n[2])),
                ("z desired, shaped", |s| (s.time_s, s.force_reference_n)),
                ("x", |s| (s.time_s, -s.force_n[0])),
                ("y", |s| (s.time_s, -s.force_n[1])),
            ],
        },
        Plot {
            kind: "3d_tanks",
            title: "Energy in the tanks",
            x: "time, s",
            y: "J",
            equal: false,
            curves: vec![
                ("motion", |s| (s.time_s, s.tanks_j.0)),
                ("force", |s| (s.time_s, s.tanks_j.1)),
            ],
        },
    ]
}
