//! The benchmark `tangent evaluate --suite contact`: random cells and tasks, and what became of
//! them.
//!
//! [`draw`] makes one scenario from the suite's seed, the surface and the number of the draw alone,
//! so any draw can be repeated by itself. [`judge`] reads what a run shows, and [`SuiteReport`]
//! gathers the runs of a suite in two tables: by surface, and by what was drawn. The caller runs
//! the scenarios: `core/` has no threads.

mod conditions;
mod dice;
mod draw;
mod figures;
mod judgement;
mod placement;
mod ranges;
mod report;
mod surface_kind;
mod table;

pub use conditions::Conditions;
pub use draw::{Draw, draw};
pub use figures::{Figures, MeanAndP95, NormalFigures};
pub use judgement::{Judgement, judge};
pub use report::{ConditionRow, Row, SuiteReport};
pub use surface_kind::SurfaceKind;

use crate::scenario_file::ScenarioError;
use crate::systems::admittance::evaluate_admittance_samples;

/// Runs one draw to its end and judges it.
///
/// # Errors
/// The cell of the draw cannot be built, or its task, law or estimators are not usable.
pub fn run(draw: &Draw) -> Result<Judgement, ScenarioError> {
    let mut peak_n = 0.0_f64;
    let (evaluation, samples) = evaluate_admittance_samples(&draw.scenario, |cycle| {
        peak_n = peak_n.max(cycle.truth.load_n);
    })?;
    Ok(judge(draw, &evaluation, &samples, peak_n))
}
