//! What a task with `[coverage]` has covered, as its controller found it.

use tangent_control::{CoverageOutcome, CoverageResult};
use tangent_schemas::tangent::CoverageState;

use crate::run::Run;
use crate::task_run::{TaskRun, within};

/// The last result of the task; `None` for a task without `[coverage]`, and in recordings without
/// `control/coverage`.
pub(crate) fn result(run: &Run, task: &TaskRun<'_>) -> Option<CoverageResult> {
    let activation = task.cycles.last()?.control.activation;
    let of_time = within(&run.coverage, |m| &m.header, task.window_ns);
    let last = of_time.iter().rev().find(|m| m.activation == activation)?;
    Some(of_message(last))
}

fn of_message(state: &CoverageState) -> CoverageResult {
    CoverageResult {
        rounds: state.share_by_round.len().max(1) as u32,
        share_by_round: state.share_by_round.clone(),
        share: state.share,
        share_min: state.share_min,
        // An unknown number is from a later version.
        outcome: CoverageOutcome::from_code(state.outcome).unwrap_or_default(),
        area_cm2: state.area_cm2,
        under_cm2: state.under_cm2,
        over_cm2: state.over_cm2,
        holes: state.holes,
        largest_hole_cm2: state.largest_hole_cm2,
        largest_hole_m: state.largest_hole_m,
        dose_n_s_per_cm2: state.dose_n_s_per_cm2,
    }
}

/// The result in a sentence: `99.6 % of 71.0 cm² within the band after 2 rounds (target 99 %)`, and
/// why it is less.
pub fn sentence(result: &CoverageResult) -> String {
    let rounds = match (result.outcome, result.share_by_round.len()) {
        (CoverageOutcome::TaskEnded, 0) => "in a first round that did not end".to_owned(),
        (_, 0 | 1) => "after 1 round".to_owned(),
        (_, rounds) => format!("after {rounds} rounds"),
    };
    let why = match result.outcome {
        CoverageOutcome::Met => String::new(),
        outcome => format!(": {}", outcome.text()),
    };
    format!(
        "{} of {:.1} cm² within the band {rounds} (target {} %){why}",
        percent(result.share, result.share_min),
        result.area_cm2,
        // 0.29 is 28.999 hundredths.
        (1e6 * result.share_min).round() / 1e4
    )
}

/// Share in percent. Rounding never lifts it to the target or to the whole.
fn percent(share: f64, share_min: f64) -> String {
    let tenths = |share: f64| (1e3 * share).round() / 1e3;
    let shown = tenths(share);
    let lifted = |limit: f64| share < limit && shown >= tenths(limit);
    if lifted(share_min) || lifted(1.0) {
        format!("{:.1} %", (1e3 * share).floor() / 10.0)
    } else {
        format!("{:.1} %", 100.0 * share)
    }
}

/// The figures behind the sentence, each in a few words.
pub fn details(result: &CoverageResult) -> Vec<String> {
    let shares: Vec<String> = (result.share_by_round.iter())
        .map(|share| percent(*share, result.share_min))
        .collect();
    let mut all = Vec::new();
    if shares.len() > 1 {
        all.push(format!("after each round {}", shares.join(", ")));
    }
    let holes = match result.holes {
        0 => "no place with too little".to_owned(),
        1 => "1 place with too little".to_owned(),
        holes => format!("{holes} places with too little"),
    };
    all.push(if result.holes == 0 {
        holes
    } else {
        let [x, y] = result.largest_hole_m.map(|m| 1e3 * m);
        format!(
            "{holes}, {:.2} cm²; the largest {:.2} cm² at x {x:.0} mm, y {y:.0} mm of the path's plane",
            result.under_cm2, result.largest_hole_cm2
        )
    });
    all.push(format!("{:.2} cm² with too much", result.over_cm2));
    let [least, most] = result.dose_n_s_per_cm2;
    all.push(format!("dose from {least:.2} to {most:.2} N·s/cm²"));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(outcome: CoverageOutcome, shares: &[f64]) -> CoverageResult {
        of_message(&CoverageState {
            outcome: outcome as u8,
            share_by_round: shares.iter().copied().collect(),
            share: shares.last().copied().unwrap_or(0.2),
            share_min: 0.99,
            area_cm2: 71.04,
            under_cm2: 0.31,
            holes: 2,
            largest_hole_cm2: 0.2,
            largest_hole_m: [0.012, -0.034],
            dose_n_s_per_cm2: [0.5, 5.25],
            ..CoverageState::default()
        })
    }

    #[test]
    fn the_sentence_says_how_much_after_how_many_rounds_and_why_not_more() {
        let met = state(CoverageOutcome::Met, &[0.7593, 0.9956]);
        assert_eq!(
            sentence(&met),
            "99.6 % of 71.0 cm² within the band after 2 rounds (target 99 %)"
        );
        assert_eq!(
            details(&met).join("; "),
            "after each round 75.9 %, 99.6 %; 2 places with too little, 0.31 cm²; the largest \
             0.20 cm² at x 12 mm, y -34 mm of the path's plane; 0.00 cm² with too much; dose from \
             0.50 to 5.25 N·s/cm²"
        );
        // Not 99.0 %, which would be enough.
        let little = state(CoverageOutcome::RoundsMax, &[0.98996]);
        assert_eq!(
            sentence(&little),
            "98.9 % of 71.0 cm² within the band after 1 round (target 99 %): given up: all rounds \
             that the task allows are used"
        );
        let ended = sentence(&state(CoverageOutcome::TaskEnded, &[]));
        assert!(
            ended.starts_with("20.0 % of 71.0 cm² within the band in a first round"),
            "{ended}"
        );
        assert!(ended.ends_with("the task ended before"), "{ended}");
    }
}
