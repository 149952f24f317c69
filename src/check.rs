//! `tangent check`: checks files offline by every rule that would be applied later.

use std::path::Path;

use anyhow::Result;
use serde_json::json;
use tangent_check::{FileKind, Findings, OnCell, check_file};

use crate::cli::Check;
use crate::output::{Outcome, print_json};
use crate::table::message;

/// Checks the files and prints the errors in each.
///
/// # Errors
/// The cell that `--cell` names is invalid, and a task is to be checked on it.
pub fn run(args: &Check, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    let cell = cell.map(|path| OnCell::load(path, &args.start));
    let cell = cell.transpose()?;
    let asked = args.kind.map(FileKind::from);
    let mut rows = Vec::new();
    let mut refused = false;
    for path in &args.files {
        let (kind, findings) = check_file(path, asked, cell.as_ref());
        refused |= !findings.errors.is_empty();
        if json {
            rows.push(json!({
                "file": path.display().to_string(),
                "kind": kind.map(|kind| kind.to_string()),
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

fn print(path: &Path, kind: Option<FileKind>, findings: &Findings) {
    let name = path.display();
    let kind = kind.map_or_else(|| "file".to_owned(), |kind| kind.to_string());
    if findings.errors.is_empty() {
        println!("{name}: {kind}, good");
    } else {
        println!("{name}: {kind}, refused");
    }
    for error in &findings.errors {
        error.lines().for_each(|line| message(2, line));
    }
    for note in &findings.notes {
        message(2, &format!("note: {note}"));
    }
}
