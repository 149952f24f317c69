//! Result of a run of any system, as printed by `evaluate --json`.

use serde::Serialize;
use tangent_control::{CoverageResult, Fault, Phase};
use tangent_schemas::Text;

use crate::metrics::object::ObjectFigures;
use crate::metrics::visuo_tactile::VisuoTactileFigures;
use crate::metrics::{CycleSample, Figures};

/// Time for which a run continues after its task has ended, s.
const AFTER_END_S: f64 = 0.2;

/// Result that `evaluate --json` prints. The caller adds the wall time, as `core/` has no clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Name of the scenario.
    pub scenario: String,
    /// Preset of the control law.
    pub controller: String,
    /// Estimator in use at the end.
    pub estimator: String,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Simulated time, s.
    pub duration_s: f64,
    /// Number of arm periods.
    pub steps: u64,
    /// Wall time of the run, s.
    pub wall_s: Option<f64>,
    /// Simulated time over wall time.
    pub real_time_factor: Option<f64>,
    /// Figures computed from the samples.
    #[serde(flatten)]
    pub figures: Figures,
    /// Figures of scenarios of kind `object_pose` only.
    pub object_pose: Option<ObjectFigures>,
    /// Figures of scenarios of kind `visuo_tactile` only.
    pub tactile: Option<VisuoTactileFigures>,
    /// Dose over the region, of tasks with `[coverage]` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<CoverageResult>,
    /// Always null here; only a live run has it.
    pub r#loop: Option<()>,
    /// Phase at the end.
    pub phase: &'static str,
    /// Fault that ended the task early; null if there was none.
    pub fault: Option<Text>,
    /// Hash of the whole trajectory.
    pub state_digest: String,
}

impl Evaluation {
    /// Adds the wall time of the run.
    pub fn with_wall_time(mut self, wall_s: f64) -> Self {
        self.wall_s = Some(wall_s);
        self.real_time_factor = (wall_s > 0.0).then(|| self.duration_s / wall_s);
        self
    }
}

/// End of a run, and the parts of the evaluation that are not figures.
pub(crate) struct RunEnd<'a> {
    /// Name of the scenario.
    pub scenario: &'a str,
    /// Preset of the control law.
    pub controller: &'a str,
    /// Estimator in use at the end.
    pub estimator: &'a str,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Simulated time, s.
    pub duration_s: f64,
    /// Fault that ended the task early.
    pub fault: Option<Fault>,
    /// Hash of the whole trajectory.
    pub state_digest: String,
}

impl Evaluation {
    /// Evaluation of a run with these samples, with the figures that all systems have.
    pub(crate) fn of(end: RunEnd<'_>, samples: &[CycleSample]) -> Self {
        Self {
            scenario: end.scenario.to_owned(),
            controller: end.controller.to_owned(),
            estimator: end.estimator.to_owned(),
            seed: end.seed,
            duration_s: end.duration_s,
            steps: samples.len() as u64,
            wall_s: None,
            real_time_factor: None,
            figures: Figures::of(samples),
            object_pose: None,
            tactile: None,
            coverage: None,
            r#loop: None,
            phase: samples.last().map_or(Phase::Idle, |s| s.phase).name(),
            fault: end.fault.map(|fault| fault.text()),
            state_digest: end.state_digest,
        }
    }
}

/// Steps a loop until `duration_s` has passed, or until shortly after its task has ended. `step`
/// runs one period of `period_s`.
pub(crate) fn run_to_end(
    duration_s: f64,
    period_s: f64,
    mut step: impl FnMut() -> CycleSample,
) -> Vec<CycleSample> {
    let steps = (duration_s / period_s).round() as usize;
    let mut samples = Vec::with_capacity(steps);
    let mut ended_at = None;
    for _ in 0..steps {
        let sample = step();
        samples.push(sample);
        if !sample.phase.is_active() {
            let since = *ended_at.get_or_insert(sample.time_s);
            if sample.time_s - since >= AFTER_END_S {
                break;
            }
        }
    }
    samples
}
