//! A task, alone or on a cell.

use anyhow::Result;
use tangent_control::Task;
use tangent_control::preflight::words;
use tangent_controller::{known_estimators, unknown_estimators};
use tangent_mechanics::names::nearest;
use tangent_runtime::CellConfig;

use super::{Findings, OnCell};
use crate::output::bad_usage;
use crate::scenarios::Played;
use crate::{compose, simulated_plant};

pub fn check(text: &str, cell: Option<&OnCell>, findings: &mut Findings) {
    let task: Task = match text.parse() {
        Ok(task) => task,
        Err(error) => return findings.error(error),
    };
    let Some(cell) = cell else {
        estimators(&task, &[], findings);
        findings.note("limits, reach and workspace are those of a cell: name one with --cell");
        return;
    };
    let start = cell.start.as_deref();
    match tangent_controller::refusals(&cell.config, &cell.model, &task, start) {
        Ok(refusals) => findings.errors.extend(words(&refusals)),
        Err(error) => findings.error(error),
    }
    estimators(&task, &cell.config.estimators.run, findings);
    if start.is_none() {
        findings.note(cell.no_start.clone());
    }
}

/// Unknown estimators. A name close to a known one is a slip; another may be an
/// estimator of the user's own.
pub fn estimators(task: &Task, own: &[String], findings: &mut Findings) {
    let known = known_estimators(own);
    let strange = task.estimators.iter().map(String::as_str);
    let strange: Vec<&str> = strange.filter(|name| !known.contains(name)).collect();
    let (slips, others): (Vec<&str>, Vec<&str>) = strange
        .into_iter()
        .partition(|name| nearest(name, known.iter().copied()).is_some());
    // With a slip among them all are named, so that one look at the message is enough.
    if slips.is_empty() {
        for name in others {
            findings.note(format!(
                "estimators: \"{name}\" is not built in: the task is refused unless it publishes estimate/{name}/normal when the task is started"
            ));
        }
        return;
    }
    let all = [slips, others].concat();
    findings.errors.extend(unknown_estimators(&all, &known));
}

/// Refuses a task that the cell's controller would refuse, before anything is started.
///
/// # Errors
/// Every reason that is found: exit code 2.
pub fn before_start(config: &CellConfig, task: &str, played: &Played) -> Result<()> {
    let cell = OnCell {
        model: compose::model(config)?,
        start: Some(simulated_plant::start(played).map_err(bad_usage)?),
        no_start: String::new(),
        config: config.clone(),
    };
    let mut findings = Findings::default();
    super::cell::services(config, &mut findings);
    if !findings.errors.is_empty() {
        return Err(bad_usage(findings.errors.join("; ")));
    }
    check(task, Some(&cell), &mut findings);
    if findings.errors.is_empty() {
        return Ok(());
    }
    Err(bad_usage(format!("task: {}", findings.errors.join("; "))))
}
