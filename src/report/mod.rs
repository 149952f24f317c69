//! `tangent report`: the figures of a recording, and a page with plots.

mod comparison;
mod figures;
mod html;
pub mod object;
pub mod plot;
pub mod run;
pub mod tactile;
mod task_run;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::output::{Outcome, print_json};
pub use comparison::{EstimatorFigures, estimators, words as estimator_words};
pub use figures::{Quantiles, Report};
use run::Run;
pub use task_run::TaskRun;

/// Reads a recording (of a folder, the newest one), prints its figures, writes its page.
///
/// # Errors
/// A file that cannot be read, is no recording or holds nothing of a tangent cell; a page that
/// cannot be written.
pub fn run(args: &crate::cli::Report, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    let cell = cell.map(cell_name).transpose()?;
    let files = recordings(&args.file)?;
    let (recorded, page) = read(&files, cell.as_deref(), !args.no_html)?;
    for path in &recorded.truncated {
        eprintln!(
            "{}: lacks its end, read up to the last whole chunk; a recorder that starts in this folder mends it",
            path.display()
        );
    }
    let report = recorded.report;
    let html = args.html.clone().unwrap_or_else(|| beside(&files[0]));
    if let Some(page) = page {
        write_page(&html, &page)?;
    }
    if json {
        print_json(&report)?;
    } else {
        print!("{}", words(&report));
        if !args.no_html {
            println!("page: {}", html.display());
        }
    }
    Ok(if report.is_lossy() {
        Outcome::Lossy
    } else {
        Outcome::Done
    })
}

/// Figures and page of one run, whose recording may have been rotated through several files; the
/// page is written beside the first. For `tangent up`.
///
/// # Errors
/// As [`run()`].
pub fn write_for(recordings: &[PathBuf]) -> Result<(Report, PathBuf)> {
    let first = recordings
        .first()
        .context("there is no recording to report on: the recorder wrote no file")?;
    let (recorded, page) = read(recordings, None, true)?;
    let html = beside(first);
    if let Some(page) = page {
        write_page(&html, &page)?;
    }
    Ok((recorded.report, html))
}

struct Read {
    report: Report,
    truncated: Vec<PathBuf>,
}

/// The cell that is meant: by its file, or by its name.
///
/// # Errors
/// A cell file that cannot be read.
pub fn cell_name(cell: &Path) -> Result<String> {
    if cell.is_file() {
        return Ok(crate::cell::load(Some(cell), None)?.cell.name);
    }
    Ok(cell.display().to_string())
}

fn read(paths: &[PathBuf], cell: Option<&str>, page: bool) -> Result<(Read, Option<String>)> {
    let run = Run::read(paths, cell)?;
    let task = TaskRun::of(&run);
    let report = Report::of(&run, &task);
    let page = page.then(|| html::page(&run, &task, &report)).transpose()?;
    let read = Read {
        report,
        truncated: run.truncated,
    };
    Ok((read, page))
}

/// The file itself; of a folder, the files of its newest run (`CELL-STAMP-NNN.mcap`, NNN counts),
/// at least one.
fn recordings(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let of_run = |path: &PathBuf| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        stem.rsplit_once('-')
            .map_or(stem.to_string(), |(run, _)| run.to_owned())
    };
    let listing = fs::read_dir(path).with_context(|| format!("listing {}", path.display()))?;
    let mut files: Vec<PathBuf> = listing
        .flatten()
        .map(|entry| entry.path())
        .filter(|file| file.extension().is_some_and(|e| e == "mcap"))
        .collect();
    let modified = |file: &PathBuf| fs::metadata(file).and_then(|m| m.modified()).ok();
    let newest = files
        .iter()
        .max_by_key(|file| modified(file))
        .map(of_run)
        .with_context(|| format!("no recording (.mcap) in {}", path.display()))?;
    files.retain(|file| of_run(file) == newest);
    files.sort();
    Ok(files)
}

fn beside(recording: &Path) -> PathBuf {
    recording.with_extension("html")
}

fn write_page(path: &Path, page: &str) -> Result<()> {
    fs::write(path, page).with_context(|| {
        format!(
            "the page {} could not be written; name another place with --html, or leave it out with --no-html",
            path.display()
        )
    })
}

/// The headline figures for a terminal.
pub fn words(report: &Report) -> String {
    let f = &report.figures;
    let mut lines = vec![format!(
        "{}: {:.1} s, {} cycles, ended in {}",
        report.scenario.as_deref().unwrap_or("recording"),
        report.duration_s,
        report.steps,
        report.phase.unwrap_or("no task"),
    )];
    if let Some(e) = f.normal_error_deg {
        lines.push(format!(
            "normal error     {:.2} deg mean, {:.2} deg RMS",
            e.mean, e.rmse
        ));
    }
    if let Some(e) = f.alignment_error_deg {
        lines.push(format!(
            "alignment error  {:.2} deg mean, {:.2} deg RMS",
            e.mean, e.rmse
        ));
    }
    if let (Some(mean), Some(rmse)) = (f.force.mean_n, f.force.rmse_n) {
        lines.push(format!(
            "force            {mean:.2} N of {:.2} N, error {rmse:.3} N RMS",
            f.force.reference_n
        ));
    }
    if let Some(rmse) = f.path.rmse_m {
        lines.push(format!("path error       {:.2} mm RMS", 1e3 * rmse));
    }
    if let Some(fraction) = f.contact.fraction {
        lines.push(format!(
            "contact          {:.2} % of the time, lost {} times",
            100.0 * fraction,
            f.contact.lost_count
        ));
    }
    if let Some(object) = &report.object_pose {
        lines.extend(object::words(object));
    }
    lines.extend(report.tactile.as_ref().and_then(tactile::words));
    let l = &report.r#loop;
    if let Some(q) = l.packet_to_command_us {
        lines.push(format!(
            "packet to command {:.0} us median, {:.0} us p99, {:.0} us max; {} cycles missed",
            q.p50,
            q.p99,
            q.max,
            l.missed_cycles.unwrap_or(0)
        ));
    }
    let count = |n: Option<u64>| n.map_or_else(|| "unknown".to_owned(), |n| n.to_string());
    lines.push(format!(
        "lost             {} sensor records, {} messages",
        count(l.wrench_records_lost),
        count(l.messages_dropped)
    ));
    if let Some(age_s) = l.zero_age_max_s {
        let bound = l.zero_bound_max_n.map_or_else(String::new, |n| {
            format!(": the force may be off by {n:.2} N")
        });
        lines.push(format!("sensor's zero    at most {age_s:.0} s old{bound}"));
    }
    for switch in &report.estimator_switches {
        lines.push(format!(
            "normal           at {:.2} s by {} after {}: {}",
            switch.time_s, switch.to, switch.from, switch.cause
        ));
    }
    if let Some(fault) = &report.fault {
        lines.push(format!("fault            {fault}"));
    }
    lines.push(String::new());
    let mut text = lines.join("\n");
    if report.estimators.len() > 1 {
        text += &estimator_words(&report.estimators, report.estimator.as_deref());
    }
    text
}
