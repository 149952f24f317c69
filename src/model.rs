//! `tangent model`: list, show and check robot models.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use serde_json::json;
use tangent_compose::model_file;
use tangent_mechanics::names::did_you_mean;
use tangent_mechanics::urdf::{self, Mounted};
use tangent_mechanics::{ModelData, golden};

use crate::cli::ModelCommand;
use crate::output::{Outcome, bad_usage, print_json};
use crate::table::Columns;

/// Runs one of the model commands.
///
/// # Errors
/// A name is unknown, or a file cannot be read or is not a model.
pub fn run(command: &ModelCommand, json: bool) -> Result<Outcome> {
    match command {
        ModelCommand::List => list(json),
        ModelCommand::Show { name } => show(name, json),
        ModelCommand::Urdf { name } => urdf_of(name, json),
        ModelCommand::Check { file, model } => check(file, model, json),
    }
}

fn list(json: bool) -> Result<Outcome> {
    let models: Vec<ModelData> = ModelData::builtin_names()
        .map(ModelData::builtin)
        .collect::<Result<_, _>>()?;
    if json {
        let rows: Vec<_> = models
            .iter()
            .map(|m| json!({"name": m.name, "title": m.title, "joints": m.dof}))
            .collect();
        print_json(&json!({ "models": rows }))?;
    } else {
        let mut table = Columns::new(&["model", ">joints", "arm"]);
        for model in &models {
            table.row([
                model.name.clone(),
                model.dof.to_string(),
                model.title.clone(),
            ]);
        }
        table.print(0);
    }
    Ok(Outcome::Done)
}

/// Loads a built-in model by name, or a model file of the user.
pub fn load(name: &str) -> Result<ModelData> {
    if let Ok(model) = ModelData::builtin(name) {
        return Ok(model);
    }
    if !Path::new(name).exists() {
        let names: Vec<_> = ModelData::builtin_names().collect();
        return Err(bad_usage(format!(
            "robot model \"{name}\": neither built in ({}) nor a file{}",
            names.join(", "),
            did_you_mean(name, names.iter().copied())
        )));
    }
    Ok(model_file(Path::new(name))?)
}

fn show(name: &str, json: bool) -> Result<Outcome> {
    let model = load(name)?;
    if json {
        print_json(&model)?;
    } else if let Some(text) = ModelData::builtin_text(name) {
        print!("{text}");
    } else {
        print!("{}", toml::to_string(&model)?);
    }
    Ok(Outcome::Done)
}

fn urdf_of(name: &str, json: bool) -> Result<Outcome> {
    let text = urdf::urdf(&load(name)?, &Mounted::default())?;
    if json {
        print_json(&json!({ "urdf": text }))?;
    } else {
        print!("{text}");
    }
    Ok(Outcome::Done)
}

fn check(file: &Path, own: &[PathBuf], json: bool) -> Result<Outcome> {
    let text = fs::read_to_string(file)
        .map_err(|e| bad_usage(format!("reference values {}: {e}", file.display())))?;
    let own: Vec<ModelData> = own
        .iter()
        .map(|path| model_file(path))
        .collect::<Result<_, _>>()?;
    let rows = golden::compare(&text, &own)
        .map_err(|e| bad_usage(format!("reference values {}: {e}", file.display())))?;
    if json {
        print_json(&json!({ "models": rows }))?;
    } else {
        for row in &rows {
            println!(
                "{:<20} {:<18} {:>9.2e}  {}",
                row.name,
                row.quantity,
                row.max_relative_difference,
                if row.agrees() { "agrees" } else { "DIFFERS" }
            );
        }
    }
    Ok(if rows.iter().all(golden::Row::agrees) {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}
