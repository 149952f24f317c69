//! `tangent report`: prints the figures of a recording, and writes a page with plots.

use std::path::Path;

use anyhow::{Context, Result};
use tangent_report::{beside, read, recordings, words, write_page};
pub use tangent_report::{object, plot, tactile};

use crate::cell;
use crate::cli::Report;
use crate::output::{Outcome, print_json};
use crate::terminal;

/// Reads a recording (of a folder, the newest one), prints its figures, and writes its page.
///
/// # Errors
/// The file cannot be read, is not a recording or holds no messages of a tangent cell; or the page
/// cannot be written, or not be opened.
pub fn run(args: &Report, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    let cell = cell.map(cell_name).transpose()?;
    let files = recordings(&args.file)?;
    let recorded = read(&files, cell.as_deref(), !args.no_html)?;
    for path in &recorded.truncated {
        terminal::say(&format!(
            "{}: the end is missing; read up to the last whole chunk. A recorder that starts in this folder repairs the file",
            path.display()
        ));
    }
    let html = args.html.clone().unwrap_or_else(|| beside(&files[0]));
    if let Some(page) = recorded.page {
        write_page(&html, &page)?;
    }
    let report = recorded.report;
    if json {
        print_json(&report)?;
    } else {
        print!("{}", words(&report));
        if !args.no_html {
            println!("page: {}", html.display());
        }
    }
    if args.open {
        open::that_detached(&html)
            .with_context(|| format!("no program opens {}", html.display()))?;
    }
    Ok(if report.is_lossy() {
        Outcome::Lossy
    } else {
        Outcome::Done
    })
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
