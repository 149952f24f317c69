//! The tables of a suite: one row per surface, and the same runs by what was drawn.

use serde::Serialize;

use super::conditions::{GROUPS, Group};
use super::figures::Figures;
use super::judgement::Judgement;
use super::surface_kind::SurfaceKind;
use crate::digest::TextDigest;

/// One surface of the first table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the surface.
    pub surface: &'static str,
    /// Figures of its runs.
    #[serde(flatten)]
    pub figures: Figures,
}

/// One row of the second table: the runs of all surfaces that have something drawn in common.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConditionRow {
    /// What was drawn, with its unit, for instance `force, N`; `all` for the row of all runs.
    pub kind: &'static str,
    /// Range or name that the runs have in common, for instance `1-2`.
    pub condition: &'static str,
    /// Figures of these runs.
    #[serde(flatten)]
    pub figures: Figures,
}

/// Result of a suite. The caller adds the wall time, as `core/` has no clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SuiteReport {
    /// Name of the suite.
    pub suite: &'static str,
    /// Number of draws per surface.
    pub draws: u64,
    /// Seed of the suite.
    pub seed: u64,
    /// Wall time, s.
    pub wall_s: Option<f64>,
    /// Simulated time over wall time.
    pub real_time_factor: Option<f64>,
    /// Hash over the trajectories of all draws, by surface and number.
    pub digest: String,
    /// One row per surface.
    pub rows: Vec<Row>,
    /// One row of all runs, then one per group of runs by what was drawn; groups without runs are
    /// left out.
    pub conditions: Vec<ConditionRow>,
    /// All runs, by surface and number.
    #[serde(skip)]
    pub runs: Vec<Judgement>,
}

impl SuiteReport {
    /// Gathers runs, in any order, of a suite with `draws` per surface and a seed.
    pub fn of(draws: u64, seed: u64, mut runs: Vec<Judgement>) -> Self {
        runs.sort_by_key(|run| (run.surface, run.number));
        let mut digest = TextDigest::default();
        for run in &runs {
            digest.add(&run.digest);
        }
        Self {
            suite: "contact",
            draws,
            seed,
            wall_s: None,
            real_time_factor: None,
            digest: digest.finish(),
            rows: rows(seed, &runs),
            conditions: conditions(seed, &runs),
            runs,
        }
    }

    /// Adds the wall time of all runs together.
    pub fn with_wall_time(mut self, wall_s: f64) -> Self {
        let simulated: f64 = self.runs.iter().map(|run| run.duration_s).sum();
        self.wall_s = Some(wall_s);
        self.real_time_factor = (wall_s > 0.0).then(|| simulated / wall_s);
        self
    }
}

/// Figures of the runs that are of a group.
fn figures(seed: u64, runs: &[Judgement], is_of: impl Fn(&Judgement) -> bool) -> Option<Figures> {
    let some: Vec<&Judgement> = runs.iter().filter(|run| is_of(run)).collect();
    Figures::of(seed, &some)
}

fn rows(seed: u64, runs: &[Judgement]) -> Vec<Row> {
    let row = |surface: SurfaceKind| {
        Some(Row {
            surface: surface.name(),
            figures: figures(seed, runs, |run| run.surface == surface)?,
        })
    };
    SurfaceKind::ALL.into_iter().filter_map(row).collect()
}

fn conditions(seed: u64, runs: &[Judgement]) -> Vec<ConditionRow> {
    let row = |group: &Group| {
        Some(ConditionRow {
            kind: group.kind,
            condition: group.name,
            figures: figures(seed, runs, |run| (group.holds)(&run.conditions))?,
        })
    };
    GROUPS.iter().filter_map(row).collect()
}
