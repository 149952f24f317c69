//! Figures of the force.

use serde::{Deserialize, Serialize};
use tangent_control::Phase;

use super::sample::CycleSample;
use super::spread::{mean, percentile_95, root_mean_square};

/// Deviation within which the force counts as settled, share of the reference.
const SETTLED_SHARE: f64 = 0.10;
/// Time for which the force must stay within that deviation, s.
const SETTLED_FOR_S: f64 = 0.5;

/// Figures of the force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForceFigures {
    /// Highest reference, N.
    pub reference_n: f64,
    /// Mean pressing force while sliding and holding, from 1 s after first contact, N.
    pub mean_n: Option<f64>,
    /// Root mean square deviation from the reference while sliding and holding, from 1 s after
    /// first contact, N.
    pub rmse_n: Option<f64>,
    /// Root mean square deviation from the reference of every cycle from first contact to the
    /// retraction, N: touchdown, cycles without contact and searches for the surface included.
    /// While the law searches, the reference is that of the task.
    pub rmse_all_n: Option<f64>,
    /// That deviation in the first second after first contact, N.
    pub rmse_first_second_n: Option<f64>,
    /// Mean absolute deviation from the reference while sliding and holding, from 1 s after first
    /// contact, N.
    pub mad_n: Option<f64>,
    /// 95th percentile of the absolute deviation from the reference while sliding and holding, from
    /// 1 s after first contact, N.
    pub p95_abs_error_n: Option<f64>,
    /// Highest pressing force from first contact to the end, the retraction included, N.
    pub peak_n: Option<f64>,
    /// Peak of the whole touchdown, bounces included, above the reference, in percent of the
    /// reference; 0 if it stays below.
    pub overshoot_percent: Option<f64>,
    /// Time from first contact until the force stays within 10 % of the reference for half a
    /// second, s.
    pub settling_s: Option<f64>,
}

impl ForceFigures {
    /// `from_first`: the samples from first contact on; `span`: those of them in which the tool is
    /// meant to be on the surface; `settled_from`: time from which the force counts as settled, s.
    pub(super) fn of(
        samples: &[CycleSample],
        from_first: &[CycleSample],
        span: &[CycleSample],
        settled_from: f64,
    ) -> Self {
        let reference_n = samples
            .iter()
            .map(|s| s.force_reference_n)
            .fold(0.0, f64::max);
        let working = |s: &&CycleSample| {
            s.time_s >= settled_from && matches!(s.phase, Phase::Slide | Phase::Hold)
        };
        let forces: Vec<f64> = span
            .iter()
            .filter(working)
            .filter_map(CycleSample::pressing_n)
            .collect();
        let errors: Vec<f64> = span
            .iter()
            .filter(working)
            .filter_map(|s| Some(s.pressing_n()? - s.force_reference_n))
            .collect();
        let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
        sizes.sort_by(f64::total_cmp);

        let start = span.first().map_or(0.0, |s| s.time_s);
        let deviation = |s: &CycleSample| {
            let searching = matches!(s.phase, Phase::Seek | Phase::Approach);
            let wanted = if searching {
                reference_n
            } else {
                s.force_reference_n
            };
            Some(s.pressing_n()? - wanted)
        };
        let all: Vec<f64> = span.iter().filter_map(deviation).collect();
        let first_second: Vec<f64> = span
            .iter()
            .filter(|s| s.time_s < settled_from)
            .filter_map(deviation)
            .collect();
        let settled = settling(span, reference_n);
        let touchdown = touchdown(span, settled)
            .iter()
            .filter_map(CycleSample::pressing_n)
            .reduce(f64::max);
        let overshoot = |peak: f64| ((peak / reference_n - 1.0) * 100.0).max(0.0);
        Self {
            reference_n,
            mean_n: mean(&forces),
            rmse_n: root_mean_square(&errors),
            rmse_all_n: root_mean_square(&all),
            rmse_first_second_n: root_mean_square(&first_second),
            mad_n: mean(&sizes),
            p95_abs_error_n: (!sizes.is_empty()).then(|| percentile_95(&sizes)),
            // A retraction can press as well.
            peak_n: from_first
                .iter()
                .filter_map(CycleSample::pressing_n)
                .reduce(f64::max),
            overshoot_percent: touchdown.filter(|_| reference_n > 0.0).map(overshoot),
            settling_s: settled.map(|t| t - start),
        }
    }
}

/// The touchdown: from first contact until the force has settled or the tool slides without loss of
/// contact for long enough, including contacts lost and regained in between. The whole span if
/// neither happens.
fn touchdown(span: &[CycleSample], settled: Option<f64>) -> &[CycleSample] {
    let mut sliding_from = None;
    let mut end = span.len();
    for (i, sample) in span.iter().enumerate() {
        if settled.is_some_and(|t| sample.time_s >= t + SETTLED_FOR_S) {
            end = i;
            break;
        }
        if sample.phase != Phase::Slide || !sample.touches() {
            sliding_from = None;
            continue;
        }
        let (from, since) = *sliding_from.get_or_insert((i, sample.time_s));
        if sample.time_s - since >= SETTLED_FOR_S {
            end = from;
            break;
        }
    }
    &span[..end.max(1).min(span.len())]
}

/// Time from which the force stays within its band for `SETTLED_FOR_S`.
fn settling(span: &[CycleSample], reference_n: f64) -> Option<f64> {
    let mut since: Option<f64> = None;
    for sample in span {
        let Some(force_n) = sample.pressing_n() else {
            continue;
        };
        if (force_n - reference_n).abs() > SETTLED_SHARE * reference_n {
            since = None;
            continue;
        }
        let from = *since.get_or_insert(sample.time_s);
        if sample.time_s - from >= SETTLED_FOR_S {
            return Some(from);
        }
    }
    None
}
