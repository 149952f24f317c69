//! Coverage that closes: the dose of pressure over a region, and further strokes where it is too
//! low.
//!
//! While the tool presses, a grid of the region adds up the dose. At the end of the path, strokes
//! for the cells with too little become the path of the next round, until the share of the region
//! that the task asks for is within the band, or no further round is allowed. All room is allocated
//! while the task is loaded; each cycle does a bounded part of the planning, while the tool lifts
//! off.

mod dose_grid;
mod holes;
mod result;
mod round;
mod rules;
pub(crate) mod spec;

use nalgebra::Vector2;

use crate::error::ControlError;
use crate::task::Task;
use crate::task::path::Path;
use dose_grid::DoseGrid;
use holes::HoleSearch;
use result::Shares;
use round::{Planner, STROKES_MAX};
use rules::RoundRules;

pub use result::{CoverageOutcome, CoverageResult};
pub use spec::CoverageSpec;

/// Share of the first round in the progress of a task.
const FIRST_ROUND: f64 = 0.9;

/// Coverage of one task: the grid, and the rounds so far. Making one allocates; running it does
/// not.
#[derive(Clone, Debug)]
pub struct Coverage {
    spec: CoverageSpec,
    grid: DoseGrid,
    rules: RoundRules,
    /// Strokes of the next round, and later those of the round before.
    room: Path,
    planner: Option<Planner>,
    /// Share of the region within the band at the end of each round.
    shares: Shares,
    /// Why no further round follows; open until then.
    outcome: CoverageOutcome,
    /// When the last result was taken: number of rounds that another one follows, and whether the
    /// task had ended.
    taken: (usize, bool),
    search: HoleSearch,
}

impl Coverage {
    /// For a task with `[coverage]`; `None` without. `bounds` are those of the path's acceleration,
    /// m/s², and jerk, m/s³.
    ///
    /// # Errors
    /// The path has no outline, the region is too large or its margin too wide for the tip, or the
    /// tip is not known.
    pub(crate) fn new(
        task: &Task,
        path: &mut Path,
        bounds: (f64, f64),
    ) -> Result<Option<Self>, ControlError> {
        let Some(spec) = &task.coverage else {
            return Ok(None);
        };
        let (region, key) = spec.region(&task.path)?;
        let Some(radius_m) = spec.radius_m else {
            return Err(ControlError::range(
                "coverage.radius_m",
                "not set, and the tool's tip does not give it",
                "a radius, 0.001 to 0.1 m; or a flat, ring or soft tip with its radius in \
                 `[tool.tip]` of the cell file",
            ));
        };
        let expected = task.path.expected_surface();
        let grid = DoseGrid::new(&region, expected, radius_m, key)?;
        // The paths of two rounds take turns.
        path.reserve(STROKES_MAX);
        Ok(Some(Self {
            rules: RoundRules {
                band: spec.dose_n_s_per_cm2,
                passes: spec.passes.unwrap_or(0),
                force_n: task.force.reference_n,
                speed_m_per_s: region.speed_m_per_s,
                radius_m,
                across_m: grid.across_m,
                bounds,
            },
            search: HoleSearch::with_room(grid.cells.len()),
            grid,
            room: Path::with_room(STROKES_MAX, path.rise()),
            planner: None,
            shares: Shares::new(),
            outcome: CoverageOutcome::Open,
            taken: (0, false),
            spec: spec.clone(),
        }))
    }

    /// Adds the force of one cycle with the tool at a point of the path's plane.
    /// For a path that is drawn over the plane, `slope` is that of the surface there, m per m;
    /// otherwise zero.
    pub(crate) fn press(
        &mut self,
        in_plane: &Vector2<f64>,
        slope: &Vector2<f64>,
        force_n: f64,
        time_s: f64,
        dt_s: f64,
    ) {
        self.grid.press(in_plane, slope, force_n, time_s, dt_s);
    }

    /// The path of the round has ended, with the tool at `from`. Puts the strokes of the next round
    /// into `path` as far as they are known; without effect if there is none.
    pub(crate) fn end_round(&mut self, from: Vector2<f64>, path: &mut Path) -> bool {
        if self.is_done() {
            return false;
        }
        let share = self.grid.judge(&self.rules).share();
        let is_full = self.shares.try_push(share).is_err();
        if share >= self.spec.share_min {
            self.outcome = CoverageOutcome::Met;
        } else if is_full || self.shares.len() >= self.spec.rounds_max as usize {
            self.outcome = CoverageOutcome::RoundsMax;
        }
        if self.is_done() {
            return false;
        }
        self.room.clear();
        let mut planner = Planner::new(from, &mut self.grid);
        if !planner.step(&mut self.grid, &self.rules, &mut self.room) {
            self.outcome = CoverageOutcome::OutOfReach;
            return false;
        }
        self.planner = Some(planner);
        std::mem::swap(path, &mut self.room);
        true
    }

    /// Adds the next stroke of a round that is being planned to `path`.
    pub(crate) fn plan(&mut self, path: &mut Path) {
        if let Some(planner) = &mut self.planner
            && !planner.step(&mut self.grid, &self.rules, path)
        {
            self.planner = None;
        }
    }

    /// Progress of the task, 0 to 1, at `progress` of the path of the present round. It reaches 1
    /// only at the end of the last round.
    pub(crate) fn progress(&self, progress: f64) -> f64 {
        if self.is_done() {
            return progress;
        }
        // Each further round takes half of what is left.
        let further = 1.0 - FIRST_ROUND;
        match self.shares.len() {
            0 => FIRST_ROUND * progress,
            before => 1.0 - further * 0.5_f64.powi(before as i32 - 1) * (1.0 - 0.5 * progress),
        }
    }

    /// Whether strokes of the round are still missing.
    pub(crate) fn is_planning(&self) -> bool {
        self.planner.is_some()
    }

    /// Middle of each cell of the region in the path's plane, m, and its dose, N*s/cm².
    pub fn cells(&self) -> impl Iterator<Item = ([f64; 2], f64)> + '_ {
        (0..self.grid.cells.len())
            .filter(|&index| self.grid.cells[index].judged)
            .map(|index| (self.grid.middle(index).into(), self.grid.dose(index)))
    }

    /// Whether no further round follows.
    fn is_done(&self) -> bool {
        self.outcome != CoverageOutcome::Open
    }

    /// The map as it is now; `ended`: no task runs any more. Allocates.
    pub(crate) fn result(&self, ended: bool) -> CoverageResult {
        self.judged(ended, &mut self.search.clone())
    }

    /// The map at the end of a round that another one follows, and of the task, once; otherwise
    /// `None`. `ended`: no task runs any more. The tool presses a little longer than the last
    /// round.
    pub(crate) fn take_result(&mut self, ended: bool) -> Option<CoverageResult> {
        let followed = self.shares.len() - usize::from(self.is_done());
        if std::mem::replace(&mut self.taken, (followed, ended)) == (followed, ended) {
            return None;
        }
        let mut search = std::mem::take(&mut self.search);
        let result = self.judged(ended, &mut search);
        self.search = search;
        Some(result)
    }

    fn judged(&self, ended: bool, search: &mut HoleSearch) -> CoverageResult {
        let goal = (self.spec.share_min, self.outcome(ended));
        CoverageResult::of(&self.grid, &self.rules, &self.shares, goal, search)
    }

    fn outcome(&self, ended: bool) -> CoverageOutcome {
        if ended && !self.is_done() {
            CoverageOutcome::TaskEnded
        } else {
            self.outcome
        }
    }
}

#[cfg(test)]
mod tests;
