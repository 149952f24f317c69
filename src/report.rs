//! `tangent report`: prints the figures of a recording, and writes a page with plots; or compares
//! two runs.

use std::path::Path;

use anyhow::{Context, Result};
use tangent_report::{Part, beside, compare, read, recordings, words, write_page};
pub use tangent_report::{object, plot, tactile};

use crate::cell;
use crate::cli::Report;
use crate::output::{Outcome, bad_usage, print_json};
use crate::terminal;

/// Reads a recording (of a folder, the newest one), prints its figures, and writes its page; or
/// compares two.
///
/// # Errors
/// A file cannot be read, is not a recording or holds no messages of a tangent cell, or not this
/// task; or the page cannot be written, or not be opened.
pub fn run(args: &Report, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    let cell = cell.map(cell_name).transpose()?;
    let part = |which: usize| Part {
        cell: cell.as_deref(),
        task: args.task.get(which).copied(),
    };
    match (&args.files[..], args.task.len()) {
        ([file], 0 | 1) => one(args, file, part(0), json),
        ([file], 2) => two(args, (file, part(0)), (file, part(1)), json),
        ([a, b], 0..=2) => two(args, (a, part(0)), (b, part(1)), json),
        (_, tasks) => Err(bad_usage(format!(
            "--task: given {tasks} times; at most 2 tasks are compared"
        ))),
    }
}

fn one(args: &Report, file: &Path, part: Part<'_>, json: bool) -> Result<Outcome> {
    let files = recordings(file)?;
    let recorded = read(&files, part, !args.no_html)?;
    for path in &recorded.truncated {
        terminal::say(&format!(
            "{}: the end is missing; read up to the last whole chunk. A recorder that starts in this folder repairs the file",
            path.display()
        ));
    }
    let report = recorded.report;
    if json {
        print_json(&report)?;
    } else {
        print!("{}", words(&report));
    }
    put(args, &files[0], recorded.page, json)?;
    Ok(match report.accepted {
        Some(false) => Outcome::Failed,
        _ if report.is_lossy() => Outcome::Lossy,
        _ => Outcome::Done,
    })
}

fn two(args: &Report, a: (&Path, Part<'_>), b: (&Path, Part<'_>), json: bool) -> Result<Outcome> {
    let (files_a, files_b) = (recordings(a.0)?, recordings(b.0)?);
    let (difference, page) = compare((&files_a, a.1), (&files_b, b.1), !args.no_html)?;
    if json {
        print_json(&difference)?;
    } else {
        print!("{}", difference.words());
    }
    // The page of the first run alone keeps its name.
    let compared = files_a[0].with_extension("compared");
    put(args, &compared, page, json)?;
    let mut outcome = Outcome::Done;
    for (letter, run, file) in [("A", &difference.a, a.0), ("B", &difference.b, b.0)] {
        if run.is_lossy() {
            let file = file.display();
            terminal::say(&format!(
                "{letter}: something is missing in {file}: `tangent report {file}` says what"
            ));
            outcome = Outcome::Lossy;
        }
    }
    Ok(outcome)
}

/// Writes the page, if there is one, and opens it if that was asked for.
fn put(args: &Report, recording: &Path, page: Option<String>, json: bool) -> Result<()> {
    let Some(page) = page else {
        return Ok(());
    };
    let html = args.html.clone().unwrap_or_else(|| beside(recording));
    write_page(&html, &page)?;
    if !json {
        println!("page: {}", html.display());
    }
    if args.open {
        open::that_detached(&html)
            .with_context(|| format!("no program opens {}", html.display()))?;
    }
    Ok(())
}

/// Name of the selected cell, given by its file or by its name.
///
/// # Errors
/// The cell file cannot be read.
pub fn cell_name(cell: &Path) -> Result<String> {
    if cell.is_file() {
        return Ok(cell::load(Some(cell), None)?.cell.name);
    }
    Ok(cell.display().to_string())
}
