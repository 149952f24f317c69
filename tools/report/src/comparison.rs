//! Comparison of estimators over the same cycles, and the switches between them, in a recording or
//! a live cell.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;
use tangent_simulation::metrics::{NormalFigures, Spread, angle_deg};

use crate::run::Run;
use crate::task_run::TaskRun;

/// Figures of one estimator.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct EstimatorFigures {
    /// Rate of the estimates by their stamps, Hz.
    pub rate_hz: Option<f64>,
    /// Age of the newest estimate at use, as the controller reports it in each cycle, ms; `None` if
    /// the controller does not read the estimator.
    pub age_ms: Option<Spread>,
    /// Share of the pressing cycles in which the estimate was valid.
    pub valid_fraction: Option<f64>,
    /// Angle to the normal of the estimator in use, while both are valid and the tool presses,
    /// degrees.
    pub from_active_deg: Option<Spread>,
    /// Angle to the true normal, in contact, degrees.
    pub normal_error_deg: Option<Spread>,
    /// Angle to the true normal, in contact, from 1 s after first contact, degrees.
    pub normal_error_settled_deg: Option<Spread>,
    /// Angle to `-z_tool`, in contact, degrees.
    pub alignment_error_deg: Option<Spread>,
    /// Normalised squared error per degree of freedom; 1 if the covariance is consistent.
    pub normal_nees_per_dof: Option<f64>,
}

/// A change of the estimator in use or of its cause, such as a forced request.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Switch {
    /// Time since the start of the task, s.
    pub time_s: f64,
    /// Estimator before the change.
    pub from: String,
    /// Estimator after the change.
    pub to: String,
    /// Cause, as the controller states it.
    pub cause: String,
}

/// Figures of every estimator of the run.
pub fn estimators(run: &Run, task: &TaskRun<'_>) -> BTreeMap<String, EstimatorFigures> {
    let of = |name: &String| (name.clone(), one(run, task, name));
    run.estimates.keys().map(of).collect()
}

fn one(run: &Run, task: &TaskRun<'_>, name: &str) -> EstimatorFigures {
    let estimates = task.estimates_of(run, name);
    let samples = task.cycles.iter().map(|cycle| &cycle.sample);
    let f = NormalFigures::of(samples.zip(estimates.iter().copied()));
    let (mut from_active, mut pressing, mut valid) = (Vec::new(), 0u64, 0u64);
    for (own, cycle) in estimates.iter().zip(&task.cycles) {
        let Some(estimate) = own.filter(|_| cycle.sample.phase.is_pressing()) else {
            continue;
        };
        pressing += 1;
        valid += u64::from(estimate.valid);
        let active = cycle.sample.estimate.filter(|a| a.valid && estimate.valid);
        from_active.extend(active.map(|a| angle_deg(&estimate.normal, &a.normal)));
    }
    EstimatorFigures {
        rate_hz: rate_hz(run, name),
        age_ms: Spread::of(&mut ages_ms(run, name)),
        valid_fraction: (pressing > 0).then(|| valid as f64 / pressing as f64),
        from_active_deg: Spread::of(&mut from_active),
        normal_error_deg: f.normal_error_deg,
        normal_error_settled_deg: f.normal_error_settled_deg,
        alignment_error_deg: f.alignment_error_deg,
        normal_nees_per_dof: f.normal_nees_per_dof,
    }
}

fn rate_hz(run: &Run, name: &str) -> Option<f64> {
    let estimates = run.estimates.get(name)?;
    let stamp = |e: &tangent_schemas::tangent::NormalEstimate| e.header.stamp.to_ns();
    let span_s = (stamp(estimates.last()?) - stamp(estimates.first()?)) as f64 * 1e-9;
    (span_s > 0.0).then(|| (estimates.len() - 1) as f64 / span_s)
}

fn ages_ms(run: &Run, name: &str) -> Vec<f64> {
    let ages = run.ages_s.get(name).map_or(&[][..], Vec::as_slice);
    ages.iter().map(|age_s| 1e3 * age_s).collect()
}

/// Every change within the task, in order.
pub fn switches(task: &TaskRun<'_>) -> Vec<Switch> {
    let mut found = Vec::new();
    for pair in task.cycles.windows(2) {
        let [before, after] = [&pair[0], &pair[1]].map(|cycle| cycle.control);
        let changed =
            before.estimator != after.estimator || before.estimator_cause != after.estimator_cause;
        // The state before the first cycle of a task has no estimator.
        if changed && !before.estimator.is_empty() {
            found.push(Switch {
                time_s: pair[1].time_s,
                from: before.estimator.to_string(),
                to: after.estimator.to_string(),
                cause: after.estimator_cause.to_string(),
            });
        }
    }
    found
}

/// Formats the figures as a table for a terminal; `active` is marked.
pub fn words(all: &BTreeMap<String, EstimatorFigures>, active: Option<&str>) -> String {
    let mut text = format!(
        "  {:<17}{:>7}{:>14}{:>6}{:>14}{:>14}{:>6}\n  {:<17}{:>7}{:>14}{:>6}{:>14}{:>14}\n",
        "estimator",
        "rate",
        "age at use",
        "valid",
        "off active",
        "off truth",
        "NEES",
        "mean / p95",
        "Hz",
        "ms",
        "%",
        "deg",
        "deg",
    );
    let spread = |s: Option<Spread>, digits: usize| {
        s.map_or_else(
            || "-".to_owned(),
            |s| format!("{:.digits$} / {:.digits$}", s.mean, s.p95),
        )
    };
    let number = |x: Option<f64>, digits: usize| {
        x.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
    };
    for (name, f) in all {
        let _ = writeln!(
            text,
            "{} {name:<17}{:>7}{:>14}{:>6}{:>14}{:>14}{:>6}",
            if active == Some(name) { '*' } else { ' ' },
            number(f.rate_hz, 1),
            spread(f.age_ms, 1),
            number(f.valid_fraction.map(|x| 100.0 * x), 1),
            spread(f.from_active_deg, 2),
            spread(f.normal_error_deg, 2),
            number(f.normal_nees_per_dof, 2),
        );
    }
    text
}
