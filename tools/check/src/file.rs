//! Checks one file of any kind.

use std::fs;
use std::path::Path;

use tangent_compose::with_causes;
use tangent_control::preflight::words;
use tangent_mechanics::ModelData;
use tangent_simulated_cell::{cell_of_scenario, scenarios};

use crate::findings::Findings;
use crate::kind::{self, FileKind};
use crate::on_cell::OnCell;
use crate::{cell, task};

/// Checks one file. If `asked` names no kind, the kind is inferred from the file's keys. Without
/// `cell`, a task is checked only against rules that hold on every cell. Returns the kind, if it is
/// known, and the findings.
pub fn check_file(
    path: &Path,
    asked: Option<FileKind>,
    cell: Option<&OnCell>,
) -> (Option<FileKind>, Findings) {
    let mut findings = Findings::default();
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) => {
            findings.error(error);
            return (asked, findings);
        }
    };
    let kind = match asked.map_or_else(|| kind::of(&text), Ok) {
        Ok(kind) => kind,
        Err(reason) => {
            findings.error(reason);
            return (None, findings);
        }
    };
    match kind {
        FileKind::Cell => cell::check(path, &mut findings),
        FileKind::Task => task::check(&text, cell, &mut findings),
        FileKind::Scenario => scenario(path, &mut findings),
        FileKind::Model => model(&text, &mut findings),
    }
    (Some(kind), findings)
}

/// A scenario: read, built, and its task checked from its start pose on the cell that `tangent up`
/// would make of it.
fn scenario(path: &Path, findings: &mut Findings) {
    let played = scenarios::load(&path.display().to_string(), &[]);
    let made = played.and_then(|played| Ok((cell_of_scenario(&played)?, played)));
    let (config, played) = match &made {
        Ok((config, played)) => (config, played),
        Err(error) => return findings.error(with_causes(error)),
    };
    let task = played.task();
    cell::services(config, findings);
    let start = match played.start_joints() {
        Ok(start) => start,
        Err(error) => return findings.error(error),
    };
    match tangent_compose::model(config) {
        Ok(model) => {
            let found = tangent_controller::refusals(config, &model, task, Some(&start));
            match found.map(|refusals| words(&refusals)) {
                Ok(None) => {}
                Ok(Some(refused)) => findings.error(refused),
                Err(error) => findings.error(error),
            }
        }
        Err(error) => findings.error(with_causes(&error)),
    }
    task::estimators(task, &config.estimators.run, findings);
}

fn model(text: &str, findings: &mut Findings) {
    match ModelData::from_toml(text) {
        Ok(model) if matches!(model.dof, 6 | 7) => {}
        Ok(model) => findings.note(format!(
            "dof = {}: the laws support arms of 6 or 7 joints, `hybrid_admittance` only of 6",
            model.dof
        )),
        Err(error) => findings.error(error),
    }
}
