//! What one run of the suite shows.

use serde::Serialize;
use tangent_control::{Fault, Phase};
use tangent_schemas::Text;

use super::conditions::Conditions;
use super::draw::Draw;
use super::surface_kind::SurfaceKind;
use crate::evaluation::Evaluation;
use crate::metrics::{CycleSample, SETTLING_LEFT_OUT_S, angle_deg, mean};

/// Quantiles that stand for the angles of a run: each run weighs the same in a row, however long
/// it took.
pub(super) const QUANTILES: usize = 100;

/// Figures of one run. Forces are true forces, angles are against the true surface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judgement {
    /// Surface of the draw.
    #[serde(skip)]
    pub surface: SurfaceKind,
    /// Number of the draw.
    pub number: u64,
    /// Whether the path was completed without a fault, or, where the path leaves the surface, the
    /// task ended because it did.
    pub completed: bool,
    /// Phase at the end.
    pub phase: &'static str,
    /// Fault that ended the task early.
    pub fault: Option<Text>,
    /// What was drawn.
    #[serde(flatten)]
    pub conditions: Conditions,
    /// Mean error of the estimated normal, from 1 s after first contact, degrees.
    pub normal_mean_deg: Option<f64>,
    /// Mean angle of the tool against the normal, from 1 s after first contact, degrees.
    pub tool_mean_deg: Option<f64>,
    /// Travel from first contact until the normal is found, mm; `None` if it never is.
    pub settle_mm: Option<f64>,
    /// NEES of the normal per degree of freedom.
    pub nees_per_dof: Option<f64>,
    /// Force error while sliding, share of the reference, percent.
    pub force_rmse_percent: Option<f64>,
    /// Force error of all phases from first contact to the retraction, percent.
    pub force_rmse_all_percent: Option<f64>,
    /// Highest contact force of the whole run, N: the sum of the normal forces of all points of the
    /// tip, in whatever direction each acts.
    pub peak_n: f64,
    /// That force over `max(2 x reference, 10 N)`.
    pub peak_ratio: f64,
    /// Number of times that contact was lost.
    pub lost: usize,
    /// Simulated time, s.
    pub duration_s: f64,
    /// Hash of the whole trajectory.
    pub digest: String,
    /// Quantiles of the normal's error, degrees; empty if it was never estimated in contact.
    #[serde(skip)]
    pub(super) normal_quantiles: Vec<f64>,
    /// Quantiles of the tool's angle, degrees.
    #[serde(skip)]
    pub(super) tool_quantiles: Vec<f64>,
}

/// Peaks up to this force are allowed whatever the reference, N.
const PEAK_FLOOR_N: f64 = 10.0;

/// Judges a run of `draw` by its figures, its cycles and the highest true contact force of the
/// run, N.
pub fn judge(
    draw: &Draw,
    evaluation: &Evaluation,
    samples: &[CycleSample],
    peak_n: f64,
) -> Judgement {
    let figures = &evaluation.figures;
    let reference_n = draw.scenario.task.force.reference_n;
    let percent = |n: Option<f64>| n.map(|n| 100.0 * n / reference_n);
    let settled_from = figures
        .contact
        .first_s
        .map_or(f64::INFINITY, |t| t + SETTLING_LEFT_OUT_S);
    let settled: Vec<&CycleSample> = samples
        .iter()
        .skip_while(|s| s.time_s < settled_from)
        .take_while(|s| !s.is_after_pressing())
        .filter(|s| s.truth.is_some_and(|t| t.in_contact))
        .collect();
    let normal: Vec<f64> = settled
        .iter()
        .filter_map(|s| Some(angle_deg(&s.estimate?.normal, &s.truth?.normal)))
        .collect();
    let tool: Vec<f64> = settled
        .iter()
        .filter_map(|s| s.truth.map(|t| angle_deg(&t.normal, &-t.tool_z)))
        .collect();
    Judgement {
        surface: draw.surface,
        number: draw.number,
        completed: completed(draw, evaluation),
        phase: evaluation.phase,
        fault: evaluation.fault,
        conditions: draw.conditions(),
        normal_mean_deg: mean(&normal),
        tool_mean_deg: mean(&tool),
        settle_mm: figures.normal_found_after_m.map(|m| m * 1e3),
        nees_per_dof: figures.normal_nees_per_dof,
        force_rmse_percent: percent(figures.force.rmse_n),
        force_rmse_all_percent: percent(figures.force.rmse_all_n),
        peak_n,
        peak_ratio: peak_n / PEAK_FLOOR_N.max(2.0 * reference_n),
        lost: figures.contact.lost_count,
        duration_s: evaluation.duration_s,
        digest: evaluation.state_digest.clone(),
        normal_quantiles: quantiles(normal),
        tool_quantiles: quantiles(tool),
    }
}

/// Whether the run ended as its task asks for. A path that leaves the surface has to end because
/// the surface does, and not in another way.
fn completed(draw: &Draw, evaluation: &Evaluation) -> bool {
    let ended_as = |fault: Fault| evaluation.fault == Some(fault.text());
    if draw.leaves_surface {
        return ended_as(Fault::SurfaceLost) || ended_as(Fault::SurfaceEnds);
    }
    evaluation.phase == Phase::Done.name() && evaluation.fault.is_none()
}

/// Evenly spaced quantiles; empty for no values.
fn quantiles(mut values: Vec<f64>) -> Vec<f64> {
    if values.is_empty() {
        return values;
    }
    values.sort_by(f64::total_cmp);
    let last = values.len() - 1;
    let at = |i: usize| (values.len() as f64 * (i as f64 + 0.5) / QUANTILES as f64) as usize;
    (0..QUANTILES).map(|i| values[at(i).min(last)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_stand_for_long_and_for_short_lists() {
        assert!(quantiles(Vec::new()).is_empty());
        assert_eq!(quantiles(vec![3.0]), vec![3.0; QUANTILES]);
        let many: Vec<f64> = (0..10_000).rev().map(f64::from).collect();
        let some = quantiles(many);
        assert_eq!((some[0], some[50], some[99]), (50.0, 5050.0, 9950.0));
    }
}
