//! What the map says when a task has ended.

use serde::Serialize;

use super::dose_grid::DoseGrid;
use super::rules::RoundRules;

/// Coverage of a region.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoverageResult {
    /// Number of rounds, the first included.
    pub rounds: u32,
    /// Share of the region within the band after each round.
    pub share_by_round: Vec<f64>,
    /// Share of the region within the band at the end.
    pub share: f64,
    /// Area of the region, cm².
    pub area_cm2: f64,
    /// Area below the band, cm².
    pub under_cm2: f64,
    /// Area above the band, cm².
    pub over_cm2: f64,
    /// Number of connected areas below the band.
    pub holes: u32,
    /// Least and most dose in the region, N*s/cm².
    pub dose_n_s_per_cm2: [f64; 2],
}

impl CoverageResult {
    pub(super) fn of(grid: &DoseGrid, rules: &RoundRules, shares: &[f64]) -> Self {
        let areas = grid.judge(rules);
        let doses = (0..grid.cells.len())
            .filter(|&index| grid.cells[index].judged)
            .map(|index| grid.dose(index));
        let (least, most) = doses.fold((f64::INFINITY, 0.0_f64), |(least, most), dose| {
            (least.min(dose), most.max(dose))
        });
        Self {
            rounds: shares.len().max(1) as u32,
            share_by_round: shares.to_vec(),
            share: areas.share(),
            area_cm2: areas.good + areas.under + areas.over,
            under_cm2: areas.under,
            over_cm2: areas.over,
            holes: holes(grid, rules),
            dose_n_s_per_cm2: [least.min(most), most],
        }
    }
}

/// Number of connected components of the cells with too little.
fn holes(grid: &DoseGrid, rules: &RoundRules) -> u32 {
    let mut seen = vec![false; grid.cells.len()];
    let mut count = 0;
    let mut open = Vec::new();
    for first in 0..grid.cells.len() {
        if seen[first] || !grid.is_under(first, rules) {
            continue;
        }
        count += 1;
        seen[first] = true;
        open.push(first);
        while let Some(index) = open.pop() {
            let (i, j) = grid.place(index);
            for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if let Some(next) = grid.index(i + di, j + dj)
                    && !seen[next]
                    && grid.is_under(next, rules)
                {
                    seen[next] = true;
                    open.push(next);
                }
            }
        }
    }
    count
}
