//! Checks a task, alone or on a cell.

use tangent_control::Task;
use tangent_control::preflight::words;
use tangent_controller::{known_estimators, unknown_estimators};
use tangent_mechanics::names::nearest;
use tangent_runtime::CellConfig;

use crate::error::CheckError;
use crate::findings::Findings;
use crate::on_cell::OnCell;

pub fn check(text: &str, cell: Option<&OnCell>, findings: &mut Findings) {
    let task: Task = match text.parse() {
        Ok(task) => task,
        Err(error) => return findings.error(error),
    };
    let Some(cell) = cell else {
        estimators(&task, &[], findings);
        findings.note("limits, reach and workspace depend on the cell: name it with --cell");
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

/// Reports unknown estimators. A name close to a known one is a typing error; any other may be an
/// estimator of the user's own.
pub fn estimators(task: &Task, own: &[String], findings: &mut Findings) {
    let known = known_estimators(own);
    let strange = task.estimators.iter().map(String::as_str);
    let strange: Vec<&str> = strange.filter(|name| !known.contains(name)).collect();
    let (slips, others): (Vec<&str>, Vec<&str>) = strange
        .into_iter()
        .partition(|name| nearest(name, known.iter().copied()).is_some());
    // If one name is a typing error, all unknown names are listed in the same message.
    if slips.is_empty() {
        for name in others {
            findings.note(format!(
                "estimators: \"{name}\" is not built in: the task is refused unless it publishes estimate/{name}/normal \
                 when the task is started"
            ));
        }
        return;
    }
    let all = [slips, others].concat();
    findings.errors.extend(unknown_estimators(&all, &known));
}

/// Refuses a task that the cell's services or its controller would refuse, before anything is
/// started. `start` gives the joint positions at which it starts, rad.
///
/// # Errors
/// All reasons for which the task is refused.
pub fn before_start<E: std::fmt::Display>(
    config: &CellConfig,
    task: &str,
    start: impl FnOnce() -> Result<Vec<f64>, E>,
) -> Result<(), CheckError> {
    let cell = OnCell {
        model: tangent_compose::model(config)?,
        start: Some(start().map_err(|error| CheckError::Plant(error.to_string()))?),
        no_start: String::new(),
        config: config.clone(),
    };
    let mut findings = Findings::default();
    crate::cell::services(config, &mut findings);
    if !findings.errors.is_empty() {
        return Err(CheckError::CellRefused(findings.errors.join("; ")));
    }
    check(task, Some(&cell), &mut findings);
    if findings.errors.is_empty() {
        return Ok(());
    }
    Err(CheckError::TaskRefused(findings.errors.join("; ")))
}
