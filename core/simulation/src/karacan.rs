//! The figures that `tangent reproduce karacan` prints: the published law and ours over the same
//! seeds, and how each figure is taken from their runs.

use serde::Serialize;
use tangent_control::{ControlError, Phase, UnifiedInput};

use crate::tactile_plant::TactilePlant;
use crate::{Calm, Evaluation, ScenarioError, TactileScenario, evaluate_tactile_with};

/// Scenario that is reproduced.
pub const SCENARIO: &str = "karacan_wave";
/// Scenario with rendered depth images, from which the normals are estimated.
pub const DEPTH_SCENARIO: &str = "karacan_depth";

/// A law and a source of normals to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum System {
    /// The published law with the parameters of Table I.
    Paper,
    /// Our law.
    Ours,
    /// The published law, with normals from rendered depth images.
    PaperDepth,
    /// Our law, with normals from rendered depth images.
    OursDepth,
}

impl System {
    /// All systems.
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

/// Goal of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Goal {
    AtMost(f64),
    AtLeast(f64),
    None,
}

/// One figure of one system. `here` is the mean over the seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KaracanFigure {
    /// Name of the system.
    pub row: &'static str,
    /// What is measured. `least` in the name means that the goal is a lower bound.
    pub metric: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Value in the paper.
    pub published: Option<f64>,
    /// Mean over the seeds; null if a run lacks the figure.
    pub here: Option<f64>,
    /// Worst value over the seeds.
    pub worst: Option<f64>,
    /// Goal that `here` must meet. For tanks, every seed must meet it.
    pub goal: Option<f64>,
    /// Whether the goal is met.
    pub met: Option<bool>,
}

/// The runs of one system, one per seed, and the time of a step of the law there.
pub struct Runs {
    /// System of the runs.
    pub system: System,
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
pub fn figures(runs: &[Runs]) -> Vec<KaracanFigure> {
    let mut table = Vec::new();
    for Runs {
        system,
        runs,
        step_us,
    } in runs
    {
        let row = system.name();
        let add = |metric, unit, published, goal, values: Option<Vec<f64>>, every| {
            figure(row, metric, unit, published, goal, values.as_deref(), every)
        };
        for (metric, unit, published, paper, ours, pick) in LINES {
            let goal = if system.is_published() { paper } else { ours };
            let values = picked(runs, pick);
            table.push(add(
                metric,
                unit,
                published,
                Goal::AtMost(goal),
                values,
                false,
            ));
        }
        for (metric, unit, published, goal, pick) in HELD {
            table.push(add(metric, unit, published, goal, picked(runs, pick), true));
        }
        for (metric, unit, pick) in TOLD {
            table.push(add(
                metric,
                unit,
                None,
                Goal::None,
                picked(runs, pick),
                false,
            ));
        }
        if let Some([median, p99]) = *step_us {
            let goal = Goal::AtMost(50.0);
            table.push(add(
                "law's step, median",
                "us",
                None,
                goal,
                Some(vec![median]),
                false,
            ));
            table.push(add(
                "law's step, p99",
                "us",
                None,
                goal,
                Some(vec![p99]),
                false,
            ));
        }
        let ended: Vec<f64> = runs
            .iter()
            .map(|e| f64::from(u8::from(e.phase != "done")))
            .collect();
        let failed = Some(ended);
        table.push(add(
            "runs that did not end as they should, share",
            "",
            None,
            Goal::AtMost(0.0),
            failed,
            false,
        ));
    }
    table
}

/// Value of each run; `None` if any run lacks it, so that the others do not hide that.
fn picked(runs: &[Evaluation], pick: Pick) -> Option<Vec<f64>> {
    let values: Option<Vec<f64>> = runs.iter().map(pick).collect();
    values.filter(|v| !v.is_empty())
}

fn figure(
    row: &'static str,
    metric: &'static str,
    unit: &'static str,
    published: Option<f64>,
    goal: Goal,
    values: Option<&[f64]>,
    every: bool,
) -> KaracanFigure {
    let here = values.map(|v| v.iter().sum::<f64>() / v.len() as f64);
    let worst = values.and_then(|v| match goal {
        Goal::AtLeast(_) => v.iter().copied().reduce(f64::min),
        _ => v.iter().copied().reduce(f64::max),
    });
    let held = if every { worst } else { here };
    let (bound, met) = match goal {
        Goal::AtMost(x) => (Some(x), Some(held.is_some_and(|h| h <= x))),
        Goal::AtLeast(x) => (Some(x), Some(held.is_some_and(|h| h >= x))),
        Goal::None => (None, None),
    };
    KaracanFigure {
        row,
        metric,
        unit,
        published,
        here,
        worst,
        goal: bound,
        met,
    }
}

/// Inputs of the law in every cycle of a run, for timing its steps.
///
/// # Errors
/// The scenario cannot be run.
pub fn step_inputs(scenario: &TactileScenario) -> Result<Vec<UnifiedInput>, ScenarioError> {
    let mut inputs = Vec::new();
    evaluate_tactile_with(scenario, &mut Calm, |c| inputs.push(*c.input))?;
    Ok(inputs)
}

/// Steps a new law through `inputs` and passes each step to `timed`, which calls it once.
///
/// # Errors
/// The scenario cannot be run.
pub fn replay(
    scenario: &TactileScenario,
    inputs: &[UnifiedInput],
    mut timed: impl FnMut(&mut dyn FnMut()),
) -> Result<Phase, ScenarioError> {
    let plant = TactilePlant::new(&scenario.plant, scenario.seed)?;
    let mut controller = scenario.controller(&plant)?;
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
