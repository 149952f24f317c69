//! A run of `unified_force_impedance`: figures 2 and 3 of its paper, from `evaluate` or from a
//! recording.

use nalgebra::Vector3;
use tangent_estimation::depth_normal::DEPTH_NORMAL;
use tangent_mechanics::{Base, Pose, Tool};
use tangent_simulation::metrics::visuo_tactile::{VisuoTactileFigures, VisuoTactileSample};

use crate::plot::Curve;
use crate::run::Run;
use crate::task_run::{Cycle, TaskRun};

/// One curve: its name, and the position of a sample in the plot.
type Drawn = (&'static str, fn(&VisuoTactileSample) -> (f64, f64));

/// One figure of the paper.
pub struct Plot {
    /// File stem.
    pub kind: &'static str,
    /// Heading.
    pub title: &'static str,
    /// Label of the x axis.
    pub x: &'static str,
    /// Label of the y axis.
    pub y: &'static str,
    /// Whether both axes have the same scale.
    pub equal: bool,
    /// Caption of one sentence.
    pub caption: &'static str,
    curves: &'static [Drawn],
}

/// Figure 2, and figures 3 a to d.
pub const PLOTS: [Plot; 5] = [
    Plot {
        kind: "2_surface",
        title: "The touched surface",
        x: "y, m",
        y: "z, m",
        equal: true,
        caption: "Positions of the tool in contact, over the true surface.",
        curves: &[
            ("tool", |s| (s.tool_m[1], while_pressing(s, s.tool_m[2]))),
            ("surface", |s| {
                (s.wanted_m[1], while_pressing(s, s.wanted_m[2]))
            }),
        ],
    },
    Plot {
        kind: "3a_shaping",
        title: "Shaping functions",
        x: "time, s",
        y: "",
        equal: false,
        caption: "Share of the stiffness (rho_align) and of the force (rho_frc) in force, and the contact-alignment monitor over \
                  its margin: above 1 the arm becomes compliant.",
        curves: &[
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
        caption: "In base axes.",
        curves: &[
            ("x", |s| (s.time_s, s.tool_m[0])),
            ("x desired", |s| {
                (s.time_s, while_pressing(s, s.wanted_m[0]))
            }),
            ("y", |s| (s.time_s, s.tool_m[1])),
            ("y desired", |s| {
                (s.time_s, while_pressing(s, s.wanted_m[1]))
            }),
            ("z", |s| (s.time_s, s.tool_m[2])),
            ("z desired", |s| {
                (s.time_s, while_pressing(s, s.wanted_m[2]))
            }),
        ],
    },
    Plot {
        kind: "3c_force",
        title: "Force in tool axes, as the tool presses",
        x: "time, s",
        y: "N",
        equal: false,
        caption: "Force of the tool on the surface.",
        curves: &[
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
        caption: "Energy that the law may still put into motion and force; with an empty tank it releases the tool.",
        curves: &[
            ("motion", |s| (s.time_s, s.tanks_j.0)),
            ("force", |s| (s.time_s, s.tanks_j.1)),
        ],
    },
];

impl Plot {
    /// The curves of this figure.
    fn curves(&self, samples: &[VisuoTactileSample]) -> Vec<(&'static str, Curve)> {
        let curve = |(name, pick): &Drawn| {
            let points = samples.iter().map(pick).collect();
            (*name, points)
        };
        self.curves.iter().map(curve).collect()
    }
}

/// The value while the policy is followed; elsewhere NaN, which breaks the line.
fn while_pressing(s: &VisuoTactileSample, value: f64) -> f64 {
    if s.phase.is_pressing() {
        value
    } else {
        f64::NAN
    }
}

/// The cycles of a recorded task whose law shaped stiffness and force; none for other laws.
pub fn samples(run: &Run, task: &TaskRun<'_>) -> Vec<VisuoTactileSample> {
    task.cycles
        .iter()
        .filter_map(|cycle| sample(run, cycle))
        .collect()
}

fn sample(run: &Run, cycle: &Cycle<'_>) -> Option<VisuoTactileSample> {
    let control = cycle.control;
    let shaping = run
        .shaping
        .binary_search_by_key(&control.header.stamp.to_ns(), |s| s.header.stamp.to_ns())
        .ok()
        .map(|at| &run.shaping[at])?;
    let reference = &control.path_reference;
    // Without a truth there is no surface, and the force is the one that the robot measures.
    let tool = |p| Pose::<Base, Tool>::try_from(p).ok();
    let force = match cycle.truth {
        Some(truth) => tool(&truth.tool_pose)?.unrotate(&Vector3::from(&truth.wrench.force)),
        None => Vector3::from(&control.wrench.force),
    };
    Some(VisuoTactileSample {
        time_s: cycle.time_s,
        phase: cycle.sample.phase,
        monitor: (shaping.monitor, shaping.monitor_margin),
        rho_align: shaping.rho_align,
        rho_force: shaping.rho_force,
        wanted_m: [
            reference.x,
            reference.y,
            cycle.truth.map_or(reference.z, |t| t.point.z),
        ],
        tool_m: cycle.sample.tool_position.into(),
        force_n: force.into(),
        force_reference_n: control.force_reference_n,
        tanks_j: (control.motion_tank_j, control.force_tank_j),
        normal_valid: cycle.sample.estimate.is_some_and(|e| e.valid),
        inside: None,
    })
}

/// The figures of such a task.
pub fn figures(run: &Run, task: &TaskRun<'_>) -> Option<VisuoTactileFigures> {
    let samples = samples(run, task);
    let (first, last) = (task.cycles.first()?, task.cycles.last()?);
    let cycles = first.control.cycle..=last.control.cycle;
    let frames = run.estimates.get(DEPTH_NORMAL).map_or(0, |frames| {
        frames.iter().filter(|f| cycles.contains(&f.cycle)).count()
    });
    (!samples.is_empty())
        .then(|| VisuoTactileFigures::of(&samples, first.arm.period_s, frames as u64))
}

/// Formats the figures as lines for a terminal.
pub fn words(figures: &VisuoTactileFigures) -> Option<String> {
    Some(format!(
        "shaping          rho_align from {:.2}, rho_frc from {:.2}, monitor at most {:.2} of its margin; camera {:.1} Hz",
        figures.rho_align_min?,
        figures.rho_force_min?,
        figures.monitor_share_max?,
        figures.vision_rate_hz
    ))
}

/// Draws all figures with `draw(plot, curves)`.
///
/// # Errors
/// The error of `draw`.
pub fn draw_all<E>(
    samples: &[VisuoTactileSample],
    mut draw: impl FnMut(&Plot, &[(&'static str, Curve)]) -> Result<(), E>,
) -> Result<(), E> {
    for plot in &PLOTS {
        draw(plot, &plot.curves(samples))?;
    }
    Ok(())
}
