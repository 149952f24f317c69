//! What the map says at the end of a round, and of the task.

use arrayvec::ArrayVec;
use serde::Serialize;

use super::dose_grid::DoseGrid;
use super::holes::HoleSearch;
use super::rules::RoundRules;
use super::spec::ROUNDS_MAX;

/// One share of the region for each round.
pub(super) type Shares = ArrayVec<f64, { ROUNDS_MAX as usize }>;

/// Why no further round follows. The numeric value is `CoverageState.outcome`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum CoverageOutcome {
    /// The round still runs, or another one follows.
    #[default]
    Open = 0,
    /// The share of the region within the band is what the task asks for.
    Met = 1,
    /// Too little, and the task allows no further round.
    RoundsMax = 2,
    /// Too little, and no stroke reaches what is missing.
    OutOfReach = 3,
    /// The task was stopped, or a fault ended it, before the end of its last round.
    TaskEnded = 4,
}

impl CoverageOutcome {
    /// Every outcome, by its code.
    const ALL: [Self; 5] = [
        Self::Open,
        Self::Met,
        Self::RoundsMax,
        Self::OutOfReach,
        Self::TaskEnded,
    ];

    /// The outcome with this code; `None` for an unknown one.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// The outcome in a few words.
    pub fn text(self) -> &'static str {
        match self {
            Self::Open => "not complete yet",
            Self::Met => "target met",
            Self::RoundsMax => "given up: all rounds that the task allows are used",
            Self::OutOfReach => "given up: no stroke reaches what is missing",
            Self::TaskEnded => "not complete: the task ended before",
        }
    }
}

/// Coverage of a region.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoverageResult {
    /// Number of rounds that have ended, but at least 1.
    pub rounds: u32,
    /// Share of the region within the band after each round.
    pub share_by_round: Shares,
    /// Share of the region within the band at the end.
    pub share: f64,
    /// Share of the region within the band that the task asks for.
    pub share_min: f64,
    /// Whether the share was reached, or why no further round follows.
    pub outcome: CoverageOutcome,
    /// Area of the region, cm².
    pub area_cm2: f64,
    /// Area below the band, cm².
    pub under_cm2: f64,
    /// Area above the band, cm².
    pub over_cm2: f64,
    /// Number of connected areas below the band.
    pub holes: u32,
    /// Area of the largest of them, cm²; zero if there is none.
    pub largest_hole_cm2: f64,
    /// Middle of the largest of them in the path's plane, m; zero if there is none.
    pub largest_hole_m: [f64; 2],
    /// Least and most dose in the region, N*s/cm².
    pub dose_n_s_per_cm2: [f64; 2],
}

impl CoverageResult {
    /// Judges the grid. Allocates nothing.
    pub(super) fn of(
        grid: &DoseGrid,
        rules: &RoundRules,
        shares: &Shares,
        (share_min, outcome): (f64, CoverageOutcome),
        search: &mut HoleSearch,
    ) -> Self {
        let areas = grid.judge(rules);
        let doses = (0..grid.cells.len())
            .filter(|&index| grid.cells[index].judged)
            .map(|index| grid.dose(index));
        let (least, most) = doses.fold((f64::INFINITY, 0.0_f64), |(least, most), dose| {
            (least.min(dose), most.max(dose))
        });
        let holes = search.search(grid, rules);
        Self {
            rounds: shares.len().max(1) as u32,
            share_by_round: shares.clone(),
            share: areas.share(),
            share_min,
            outcome,
            area_cm2: areas.good + areas.under + areas.over,
            under_cm2: areas.under,
            over_cm2: areas.over,
            holes: holes.count,
            largest_hole_cm2: holes.largest_cm2,
            largest_hole_m: holes.largest_m.into(),
            dose_n_s_per_cm2: [least.min(most), most],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_message() {
        for (code, outcome) in (0_u8..).zip(CoverageOutcome::ALL) {
            assert_eq!(outcome as u8, code);
            assert_eq!(CoverageOutcome::from_code(code), Some(outcome));
        }
        assert_eq!(CoverageOutcome::from_code(5), None);
    }
}
