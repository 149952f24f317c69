//! The figures that `tangent reproduce karacan` prints: the published law and ours over the same
//! seeds, and how each figure is taken from their runs.

use tangent_control::{ControlError, Phase, UnifiedInput};

use super::closed_loop::evaluate_visuo_tactile_with;
use super::scenario::VisuoTactileScenario;
use crate::disturbance::Undisturbed;
use crate::evaluation::Evaluation;
use crate::reproduction::{Goal, Metric, Over, Row, picked};
use crate::scenario_file::ScenarioError;

/// Section of the paper that has the figures.
const TABLE: &str = "Section IV (wiping the wave with 15 N for 20 s)";
/// Scenario that is reproduced.
pub const SCENARIO: &str = "karacan_wave";
/// Scenario with rendered depth images, from which the normals are estimated.
pub const DEPTH_SCENARIO: &str = "karacan_depth";

/// A law and a source of normals to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Variant {
    /// The published law with the parameters of Table I.
    Paper,
    /// Our law.
    Ours,
    /// The published law, with normals from rendered depth images.
    PaperDepth,
    /// Our law, with normals from rendered depth images.
    OursDepth,
}

impl Variant {
    /// All variants.
    pub const ALL: [Self; 4] = [Self::Paper, Self::Ours, Self::PaperDepth, Self::OursDepth];

    /// Name as text.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "preset paper",
            Self::Ours => "preset default",
            Self::PaperDepth => "preset paper, depth images drawn and read",
            Self::OursDepth => "preset default, depth images drawn and read",
        }
    }

    /// Name of the scenario that it runs.
    pub fn scenario(self) -> &'static str {
        if self.draws() {
            DEPTH_SCENARIO
        } else {
            SCENARIO
        }
    }

    /// Overrides of the scenario.
    pub fn overrides(self) -> Vec<String> {
        let preset = if self.is_published() {
            "paper"
        } else {
            "default"
        };
        vec![format!("controller=\"{preset}\"")]
    }

    /// Whether it uses rendered depth images. These take about as long to process as the simulated
    /// run lasts.
    pub fn draws(self) -> bool {
        matches!(self, Self::PaperDepth | Self::OursDepth)
    }

    /// Whether it is the published law with Table I.
    pub fn is_published(self) -> bool {
        matches!(self, Self::Paper | Self::PaperDepth)
    }
}

/// The runs of one variant, one per seed, and the time of a step of the law there.
pub struct Runs {
    /// Variant of the runs.
    pub variant: Variant,
    /// Result of each run, in order of the seeds.
    pub runs: Vec<Evaluation>,
    /// Median and 99th percentile of a step's time, µs, measured with [`step_inputs`] by a caller
    /// that has a clock.
    pub step_us: Option<[f64; 2]>,
}

type Pick = fn(&Evaluation) -> Option<f64>;

/// Metric, unit, published value, goals of the presets `paper` and `default`, and how the figure is
/// taken from a run.
type Line = (&'static str, &'static str, Option<f64>, f64, f64, Pick);

const LINES: [Line; 8] = [
    (
        "force along the normal, mean absolute deviation",
        "N",
        Some(2.0),
        2.0,
        0.5,
        |e| e.figures.force.mad_n,
    ),
    (
        "force along the normal, RMSE",
        "N",
        Some(3.0),
        3.0,
        0.75,
        |e| e.figures.force.rmse_n,
    ),
    (
        "path x, mean absolute error",
        "mm",
        Some(9.0),
        9.0,
        2.0,
        |e| mad(e, 0),
    ),
    (
        "path y, mean absolute error",
        "mm",
        Some(8.0),
        8.0,
        2.0,
        |e| mad(e, 1),
    ),
    (
        "path z, mean absolute error",
        "mm",
        Some(4.0),
        4.0,
        1.0,
        |e| mad(e, 2),
    ),
    ("path x, RMSE", "mm", Some(10.0), 10.0, 2.5, |e| rmse(e, 0)),
    ("path y, RMSE", "mm", Some(10.0), 10.0, 2.5, |e| rmse(e, 1)),
    ("path z, RMSE", "mm", Some(6.0), 6.0, 1.5, |e| rmse(e, 2)),
];

/// Metric, unit, published value, goal, and how the figure is taken from a run. Every seed must
/// meet the goal.
const HELD: [(&str, &str, Option<f64>, Goal, Pick); 6] = [
    (
        "motion tank, most",
        "J",
        Some(32.0),
        Goal::AtMost(32.0),
        |e| e.figures.tanks?.motion_max_j,
    ),
    (
        "motion tank, least",
        "J",
        Some(1.0),
        Goal::AtLeast(1.0),
        |e| e.figures.tanks?.motion_min_j,
    ),
    ("force tank, most", "J", Some(2.0), Goal::AtMost(2.0), |e| {
        Some(e.figures.tanks?.force_max_j)
    }),
    (
        "force tank, least",
        "J",
        Some(1.0),
        Goal::AtLeast(1.0),
        |e| Some(e.figures.tanks?.force_min_j),
    ),
    (
        "energy that a tank came short of",
        "J",
        None,
        Goal::AtMost(0.0),
        |e| e.tactile?.short_j,
    ),
    (
        "vision rate, least",
        "Hz",
        Some(3.0),
        Goal::AtLeast(30.0),
        |e| Some(e.tactile?.vision_rate_hz),
    ),
];

const TOLD: [(&str, &str, Pick); 4] = [
    ("tool against the true normal, mean", "deg", |e| {
        Some(e.figures.tool_error_deg?.mean)
    }),
    ("normal in use against the truth, mean", "deg", |e| {
        Some(e.figures.normal_error_deg?.mean)
    }),
    ("force, peak", "N", |e| e.figures.force.peak_n),
    ("time that a simulated second takes", "s", |e| {
        Some(1.0 / e.real_time_factor?)
    }),
];

fn mad(e: &Evaluation, axis: usize) -> Option<f64> {
    Some(e.figures.path.mad_xyz_m?[axis] * 1e3)
}

fn rmse(e: &Evaluation, axis: usize) -> Option<f64> {
    Some(e.figures.path.rmse_xyz_m?[axis] * 1e3)
}

/// All figures, in the order of `runs`.
pub fn figures(runs: &[Runs]) -> Vec<Row> {
    let mut table = Vec::new();
    for Runs {
        variant,
        runs,
        step_us,
    } in runs
    {
        let mut add = |metric: Metric, values: Option<&[f64]>| {
            table.push(Row::new(TABLE, variant.name(), metric, values));
        };
        for (name, unit, published, paper, ours, pick) in LINES {
            let goal = Goal::AtMost(if variant.is_published() { paper } else { ours });
            let metric = mean_of(name, unit, published, goal);
            add(metric, picked(runs, pick).as_deref());
        }
        for (name, unit, published, goal, pick) in HELD {
            let metric = Metric {
                over: Over::EverySeed,
                ..mean_of(name, unit, published, goal)
            };
            add(metric, picked(runs, pick).as_deref());
        }
        for (name, unit, pick) in TOLD {
            let metric = mean_of(name, unit, None, Goal::None);
            add(metric, picked(runs, pick).as_deref());
        }
        if let Some([median, p99]) = *step_us {
            for (name, time) in [("law's step, median", median), ("law's step, p99", p99)] {
                add(mean_of(name, "us", None, Goal::AtMost(50.0)), Some(&[time]));
            }
        }
        let ended: Vec<f64> = runs
            .iter()
            .map(|e| f64::from(u8::from(e.phase != "done")))
            .collect();
        let name = "share of runs that ended with a fault";
        add(mean_of(name, "", None, Goal::AtMost(0.0)), Some(&ended));
    }
    table
}

fn mean_of(name: &'static str, unit: &'static str, published: Option<f64>, goal: Goal) -> Metric {
    Metric {
        name,
        unit,
        published,
        goal,
        over: Over::Mean,
    }
}

/// Inputs of the law in every cycle of a run, for timing its steps.
///
/// # Errors
/// The scenario cannot be run.
pub fn step_inputs(scenario: &VisuoTactileScenario) -> Result<Vec<UnifiedInput>, ScenarioError> {
    let mut inputs = Vec::new();
    evaluate_visuo_tactile_with(scenario, &mut Undisturbed, |c| inputs.push(*c.input))?;
    Ok(inputs)
}

/// Steps a new law through `inputs` and passes each step to `timed`, which calls it once.
///
/// # Errors
/// The scenario cannot be run.
pub fn replay(
    scenario: &VisuoTactileScenario,
    inputs: &[UnifiedInput],
    mut timed: impl FnMut(&mut dyn FnMut()),
) -> Result<Phase, ScenarioError> {
    let mut controller = scenario.controller::<7>()?;
    let mut phase = Phase::Idle;
    for input in inputs {
        timed(&mut || phase = controller.step(input).phase);
    }
    if inputs.is_empty() {
        return Err(ScenarioError::Control(ControlError::Syntax(
            "no cycle to step through".to_owned(),
        )));
    }
    Ok(phase)
}
