//! One row of a table that compares a paper's figure with ours. The tables themselves are in
//! `systems/*/reproduction.rs`; `tangent reproduce` runs and prints them.

use serde::Serialize;

use crate::evaluation::Evaluation;
use crate::metrics::{Spread, mean};

/// One figure of one row of one table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Table or section of the paper.
    pub table: &'static str,
    /// The paper's row and our preset, or the variant that was run.
    pub row: String,
    /// Name of the figure. `least` in the name means that the goal is a lower bound.
    pub metric: &'static str,
    /// Unit of the figure.
    pub unit: &'static str,
    /// The paper's figure; null where the paper prints none.
    pub published: Option<f64>,
    /// Over the seeds: mean of Tugal et al. and of Karacan et al., median of Lippiello et al.; null
    /// if a run lacks the figure.
    pub here: Option<f64>,
    /// Worst value over the seeds.
    pub worst: Option<f64>,
    /// Bound that the goal sets; null without a goal.
    pub goal: Option<f64>,
    /// Whether the goal is met; null without a goal.
    pub met: Option<bool>,
}

/// Goal of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Goal {
    AtMost(f64),
    AtLeast(f64),
    None,
}

impl Goal {
    /// At most this value; no goal for `None`.
    pub fn at_most(bound: Option<f64>) -> Self {
        bound.map_or(Self::None, Self::AtMost)
    }

    fn bound(self) -> Option<f64> {
        match self {
            Self::AtMost(bound) | Self::AtLeast(bound) => Some(bound),
            Self::None => None,
        }
    }

    fn is_met(self, value: Option<f64>) -> Option<bool> {
        match self {
            Self::AtMost(bound) => Some(value.is_some_and(|value| value <= bound)),
            Self::AtLeast(bound) => Some(value.is_some_and(|value| value >= bound)),
            Self::None => None,
        }
    }
}

/// How the values of the seeds are combined, and which value must meet the goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Over {
    /// Mean; it must meet the goal.
    Mean,
    /// Mean; every seed must meet the goal.
    EverySeed,
    /// Median; it must meet the goal.
    Median,
}

/// A figure, with everything that is known about it before a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Metric {
    pub name: &'static str,
    pub unit: &'static str,
    pub published: Option<f64>,
    pub goal: Goal,
    pub over: Over,
}

impl Row {
    /// Combines the values of all seeds; `None` if a run lacks it.
    pub(crate) fn new(
        table: &'static str,
        row: &str,
        metric: Metric,
        values: Option<&[f64]>,
    ) -> Self {
        let here = match metric.over {
            Over::Mean | Over::EverySeed => values.and_then(mean),
            Over::Median => values.and_then(median),
        };
        let worst = values.and_then(|values| {
            let values = values.iter().copied();
            match metric.goal {
                Goal::AtLeast(_) => values.reduce(f64::min),
                _ => values.reduce(f64::max),
            }
        });
        let judged = match metric.over {
            Over::EverySeed => worst,
            Over::Mean | Over::Median => here,
        };
        Self {
            table,
            row: row.to_owned(),
            metric: metric.name,
            unit: metric.unit,
            published: metric.published,
            here,
            worst,
            goal: metric.goal.bound(),
            met: metric.goal.is_met(judged),
        }
    }
}

/// Combined value of all runs; `None` without runs or if any run lacks it, as the other runs must
/// not hide that.
pub(crate) fn picked(
    runs: &[Evaluation],
    pick: impl Fn(&Evaluation) -> Option<f64>,
) -> Option<Vec<f64>> {
    let values: Option<Vec<f64>> = runs.iter().map(pick).collect();
    values.filter(|values| !values.is_empty())
}

/// Median; `None` without values.
pub(crate) fn median(values: &[f64]) -> Option<f64> {
    Spread::of(&mut values.to_vec()).map(|spread| spread.median)
}
