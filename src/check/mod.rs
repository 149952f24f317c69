//! `tangent check`: cells, tasks, scenarios and robot models offline, with everything that would be
//! refused later.

mod cell;
mod kind;
mod task;

use std::fs;
use std::path::Path;

use anyhow::Result;
use serde::Serialize;
use serde_json::json;
use tangent_control::preflight::words;
use tangent_mechanics::ModelData;
use tangent_runtime::CellConfig;

use crate::cli::{Check, FileKind};
use crate::output::{Outcome, bad_usage, print_json};
use crate::scenarios::Played;
use crate::{compose, simulated_plant};

pub use task::before_start;

/// What is found in one file.
#[derive(Debug, Default, Serialize)]
struct Findings {
    /// What would be refused, each with key, value, what is allowed and what to do.
    errors: Vec<String>,
    /// What is not refused, or cannot be checked offline.
    notes: Vec<String>,
}

impl Findings {
    fn error(&mut self, error: impl std::fmt::Display) {
        let error = error.to_string();
        let error = error.trim().to_owned();
        // Two services may refuse the same key with the same words.
        if !self.errors.contains(&error) {
            self.errors.push(error);
        }
    }

    fn note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }
}

/// Checks the files and says what is wrong with each.
///
/// # Errors
/// The cell that `--cell` names, when a task is to be checked on it and the cell itself is wrong.
pub fn run(args: &Check, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    let cell = cell.map(|path| on_cell(path, &args.start)).transpose()?;
    let mut rows = Vec::new();
    let mut refused = false;
    for path in &args.files {
        let (kind, findings) = one(path, args.kind, cell.as_ref());
        refused |= !findings.errors.is_empty();
        if json {
            rows.push(json!({
                "file": path.display().to_string(),
                "kind": kind.map(kind::name),
                "good": findings.errors.is_empty(),
                "errors": findings.errors,
                "notes": findings.notes,
            }));
        } else {
            print(path, kind, &findings);
        }
    }
    if json {
        print_json(&json!({ "files": rows }))?;
    }
    Ok(if refused {
        Outcome::Refused
    } else {
        Outcome::Done
    })
}

/// The cell that tasks are checked on, and where the arm stands.
struct OnCell {
    config: CellConfig,
    model: ModelData,
    start: Option<Vec<f64>>,
    /// Why there is no start, in words.
    no_start: String,
}

fn on_cell(path: &Path, start: &[f64]) -> Result<OnCell> {
    let config = CellConfig::load(path).map_err(bad_usage)?;
    let model = compose::model(&config)?;
    let mut cell = OnCell {
        start: (!start.is_empty()).then(|| start.to_vec()),
        no_start: "where the arm starts is not known offline: reach and workspace are checked when the task is started, or here with --start".to_owned(),
        config,
        model,
    };
    if let Some(start) = &cell.start
        && start.len() != cell.model.dof
    {
        return Err(bad_usage(format!(
            "--start has {} joint positions; arm {} has {}",
            start.len(),
            cell.model.name,
            cell.model.dof
        )));
    }
    if cell.start.is_none()
        && let Some(scenario) = &cell.config.simulator.scenario
    {
        let mut played = Played::load(&scenario.display().to_string(), &[])?;
        simulated_plant::take_arm(&mut played, &cell.config);
        match simulated_plant::start(&played) {
            Ok(start) => cell.start = Some(start),
            Err(error) => cell.no_start = error.to_string(),
        }
    }
    Ok(cell)
}

fn one(
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
    let played = match Played::load(&path.display().to_string(), &[]) {
        Ok(played) => played,
        Err(error) => return findings.error(format!("{error:#}")),
    };
    let config = match crate::up::cell_of(&played) {
        Ok(config) => config,
        Err(error) => return findings.error(format!("{error:#}")),
    };
    cell::services(&config, findings);
    let start = match simulated_plant::start(&played) {
        Ok(start) => start,
        Err(error) => return findings.error(error),
    };
    match compose::model(&config) {
        Ok(model) => {
            let found = tangent_controller::refusals(&config, &model, played.task(), Some(&start));
            match found.map(|refusals| words(&refusals)) {
                Ok(None) => {}
                Ok(Some(refused)) => findings.error(refused),
                Err(error) => findings.error(error),
            }
        }
        Err(error) => findings.error(format!("{error:#}")),
    }
    task::estimators(played.task(), &config.estimators.run, findings);
}

fn model(text: &str, findings: &mut Findings) {
    match ModelData::from_toml(text) {
        Ok(model) if matches!(model.dof, 6 | 7) => {}
        Ok(model) => findings.note(format!(
            "dof = {}: the laws take arms of 6 joints, or of 7 on `unified_force_impedance`",
            model.dof
        )),
        Err(error) => findings.error(error),
    }
}

fn print(path: &Path, kind: Option<FileKind>, findings: &Findings) {
    let name = path.display();
    let kind = kind.map_or("file", kind::name);
    if findings.errors.is_empty() {
        println!("{name}: {kind}, good");
    } else {
        println!("{name}: {kind}, refused");
    }
    for error in &findings.errors {
        println!("  {}", error.replace('\n', "\n  "));
    }
    for note in &findings.notes {
        println!("  note: {note}");
    }
}
