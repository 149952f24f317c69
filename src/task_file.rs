//! Task files on the command line.

use std::fmt;
use std::fs;
use std::path::Path;

use anyhow::Result;
use tangent_control::Task;
use tangent_mechanics::names::did_you_mean;

use crate::output::bad_usage;

/// Reads the text of a task file. An error in it is reported here, with the file's name, before any
/// request to the cell. `else_where` names what may stand in the file's place, or is empty.
///
/// # Errors
/// The file cannot be read or is not a task: exit code 2.
pub fn task_text(file: &Path, else_where: &[&str]) -> Result<String> {
    let bad = |e: &dyn fmt::Display| bad_usage(format!("task file {}: {e}", file.display()));
    let text =
        fs::read_to_string(file).map_err(|e| bad(&format!("{e}{}", instead(file, else_where))))?;
    let _: Task = text.parse().map_err(|e| bad(&e))?;
    Ok(text)
}

fn is_task(file: &Path) -> bool {
    fs::read_to_string(file).is_ok_and(|text| text.parse::<Task>().is_ok())
}

/// For a file that does not exist: the nearest name, and all that are there.
fn instead(file: &Path, else_where: &[&str]) -> String {
    if file.exists() {
        return String::new();
    }
    let folder = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let mut names: Vec<String> = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.ends_with(".toml") && is_task(&folder.join(name)))
        .collect();
    names.sort();
    names.extend(else_where.iter().map(|name| (*name).to_owned()));
    if names.is_empty() {
        return String::new();
    }
    let wanted = file.file_name().unwrap_or_default().to_string_lossy();
    let meant = did_you_mean(&wanted, names.iter().map(String::as_str));
    format!("{meant}; there are: {}", names.join(", "))
}
