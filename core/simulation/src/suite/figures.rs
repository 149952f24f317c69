//! Figures of several runs together: a row of either table of a suite.

use serde::Serialize;

use super::conditions::LANDED_OFF_DEG;
use super::judgement::Judgement;
use crate::metrics::{Spread, mean, root_mean_square};

/// Mean and 95th percentile.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanAndP95 {
    /// Mean over the draws.
    pub mean: Option<f64>,
    /// 95th percentile over all cycles, each draw with the same weight.
    pub p95: Option<f64>,
}

/// Figures of the estimated normal, from 1 s after first contact, degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NormalFigures {
    /// Mean over the draws of their means.
    pub mean: Option<f64>,
    /// 95th percentile over all cycles, each draw with the same weight.
    pub p95: Option<f64>,
    /// Highest mean of a draw.
    pub worst_mean: Option<f64>,
}

/// Figures of several runs together. A figure that no draw has is null.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Number of draws.
    pub draws: usize,
    /// Share of the draws that were completed, percent.
    pub completed_percent: f64,
    /// Error of the estimated normal.
    pub normal_deg: NormalFigures,
    /// Travel until the normal is found, of the draws that landed 10 to 25° off: 95th percentile,
    /// mm. A draw that never found it counts as infinite, which is null.
    pub settle_mm_p95: Option<f64>,
    /// Angle of the tool against the true normal, degrees.
    pub tool_deg: MeanAndP95,
    /// Mean over the draws of their NEES per degree of freedom.
    pub nees_per_dof: Option<f64>,
    /// Force error while sliding: root mean square over the draws, percent of the reference.
    pub force_rmse_percent: Option<f64>,
    /// Force error of all phases, percent of the reference.
    pub force_rmse_all_percent: Option<f64>,
    /// Highest contact force, N.
    pub peak_n_max: f64,
    /// Highest contact force over `max(2 x reference, 10 N)`.
    pub peak_ratio_max: f64,
    /// Mean number of contacts lost.
    pub lost_mean: f64,
    /// Command that shows the worst draw again: one that was not completed before one that was,
    /// then the one with the highest peak or the highest mean error, each relative to its goal.
    pub worst: String,
}

/// Goal for the mean error of the normal in the worst draw, degrees.
const WORST_MEAN_GOAL_DEG: f64 = 3.0;

impl Figures {
    /// Figures of runs of the suite with a seed; `None` without runs.
    pub(super) fn of(seed: u64, runs: &[&Judgement]) -> Option<Self> {
        let worst = runs.iter().copied().max_by(|a, b| {
            let key = |run: &Judgement| {
                let normal = run.normal_mean_deg.unwrap_or(0.0) / WORST_MEAN_GOAL_DEG;
                (!run.completed, run.peak_ratio.max(normal))
            };
            let ((a_failed, a_size), (b_failed, b_size)) = (key(a), key(b));
            a_failed.cmp(&b_failed).then(a_size.total_cmp(&b_size))
        })?;
        let count = runs.len() as f64;
        let values = |pick: &dyn Fn(&Judgement) -> Option<f64>| -> Vec<f64> {
            runs.iter().filter_map(|run| pick(run)).collect()
        };
        let normal = values(&|run| run.normal_mean_deg);
        let settle = runs
            .iter()
            .filter(|run| run.conditions.landed_deg >= LANDED_OFF_DEG)
            .map(|run| run.settle_mm.unwrap_or(f64::INFINITY))
            .collect();
        let pooled = |pick: &dyn Fn(&Judgement) -> &Vec<f64>| {
            percentile_95(runs.iter().flat_map(|run| pick(run).clone()).collect())
        };
        let highest =
            |pick: &dyn Fn(&Judgement) -> f64| runs.iter().map(|run| pick(run)).fold(0.0, f64::max);
        Some(Self {
            draws: runs.len(),
            completed_percent: 100.0 * runs.iter().filter(|run| run.completed).count() as f64
                / count,
            normal_deg: NormalFigures {
                mean: mean(&normal),
                p95: pooled(&|run| &run.normal_quantiles),
                worst_mean: normal.iter().copied().reduce(f64::max),
            },
            settle_mm_p95: percentile_95(settle).filter(|mm| mm.is_finite()),
            tool_deg: MeanAndP95 {
                mean: mean(&values(&|run| run.tool_mean_deg)),
                p95: pooled(&|run| &run.tool_quantiles),
            },
            nees_per_dof: mean(&values(&|run| run.nees_per_dof)),
            force_rmse_percent: root_mean_square(&values(&|run| run.force_rmse_percent)),
            force_rmse_all_percent: root_mean_square(&values(&|run| run.force_rmse_all_percent)),
            peak_n_max: highest(&|run| run.peak_n),
            peak_ratio_max: highest(&|run| run.peak_ratio),
            lost_mean: runs.iter().map(|run| run.lost as f64).sum::<f64>() / count,
            worst: again(worst, seed),
        })
    }
}

/// Command that shows a run again.
fn again(run: &Judgement, seed: u64) -> String {
    format!(
        "tangent evaluate --suite contact --surface {} --draw {} --seed {seed}",
        run.surface.name(),
        run.number
    )
}

/// 95th percentile; `None` without values.
fn percentile_95(mut values: Vec<f64>) -> Option<f64> {
    Spread::of(&mut values).map(|spread| spread.p95)
}
