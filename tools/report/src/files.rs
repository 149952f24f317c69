//! Reads the files of a recording, and writes the page of its report.

use std::fs;
use std::path::{Path, PathBuf};

use crate::difference::Difference;
use crate::error::ReportError;
use crate::figures::Report;
use crate::html;
use crate::run::Run;
use crate::task_run::TaskRun;

/// The report on a recording.
pub struct Read {
    /// All figures.
    pub report: Report,
    /// Files that lack their end.
    pub truncated: Vec<PathBuf>,
    /// The page as HTML, if it was requested.
    pub page: Option<String>,
}

/// What of a recording is reported.
#[derive(Clone, Copy, Debug, Default)]
pub struct Part<'a> {
    /// Name of the cell; needed if the recording holds several.
    pub cell: Option<&'a str>,
    /// Number of the task, from 1; `None`: the last one.
    pub task: Option<usize>,
}

/// Reads a part of one run, which may be spread over several files. With `page`, the page is
/// generated too.
///
/// # Errors
/// A file cannot be read, is not a recording or holds no messages of a tangent cell, or not this
/// task; a plot cannot be drawn.
pub fn read(paths: &[PathBuf], part: Part<'_>, page: bool) -> Result<Read, ReportError> {
    let mut run = part.of(paths)?;
    let task = TaskRun::of(&run);
    // Figures and drawings take about the same time: each has a thread.
    let (report, page) = std::thread::scope(|scope| {
        let drawing = page.then(|| scope.spawn(|| html::draw(&run, &task)));
        let report = Report::of(&run, &task);
        let drawn = drawing.map(|drawing| {
            let drawn = drawing.join();
            drawn.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        });
        let page = drawn.map(|drawn| html::page(&run, &task, &report, &drawn?));
        (report, page.transpose())
    });
    let page = page?;
    drop(task);
    let truncated = std::mem::take(&mut run.truncated);
    // Hundreds of megabytes of small pieces: nobody waits until they are given back.
    drop(std::thread::Builder::new().spawn(move || drop(run)));
    Ok(Read {
        report,
        truncated,
        page,
    })
}

/// Compares two runs, given by their files and parts; with `page`, the page of the comparison is
/// generated too.
///
/// # Errors
/// As [`read`].
pub fn compare(
    a: (&[PathBuf], Part<'_>),
    b: (&[PathBuf], Part<'_>),
    page: bool,
) -> Result<(Difference, Option<String>), ReportError> {
    let (run_a, run_b) = (a.1.of(a.0)?, b.1.of(b.0)?);
    let (task_a, task_b) = (TaskRun::of(&run_a), TaskRun::of(&run_b));
    let difference = Difference::between((&run_a, &task_a), (&run_b, &task_b));
    let page = page
        .then(|| html::two(&difference, &task_a, &task_b))
        .transpose()?;
    Ok((difference, page))
}

impl Part<'_> {
    fn of(self, paths: &[PathBuf]) -> Result<Run, ReportError> {
        let mut run = Run::read(paths, self.cell)?;
        if let Some(number) = self.task {
            run.keep_task(number)?;
        }
        Ok(run)
    }
}

/// Returns figures and page of one run. The page is written beside the first file.
///
/// # Errors
/// The run cannot be read, see [`read`]; or the page cannot be written.
pub fn write_for(recordings: &[PathBuf]) -> Result<(Report, PathBuf), ReportError> {
    let first = recordings.first().ok_or(ReportError::NoFile)?;
    let read = read(recordings, Part::default(), true)?;
    let html = beside(first);
    if let Some(page) = read.page {
        write_page(&html, &page)?;
    }
    Ok((read.report, html))
}

/// Returns the file itself; for a folder, the files of its newest run (`CELL-STAMP-NNN.mcap`, NNN
/// counts), at least one.
///
/// # Errors
/// The folder cannot be listed, or has no recording.
pub fn recordings(path: &Path) -> Result<Vec<PathBuf>, ReportError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let of_run = |path: &PathBuf| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        stem.rsplit_once('-')
            .map_or(stem.to_string(), |(run, _)| run.to_owned())
    };
    let listing = fs::read_dir(path).map_err(|source| ReportError::Folder {
        folder: path.to_owned(),
        source,
    })?;
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
        .ok_or_else(|| ReportError::EmptyFolder(path.to_owned()))?;
    files.retain(|file| of_run(file) == newest);
    files.sort();
    Ok(files)
}

/// Default path of the page: beside the recording.
pub fn beside(recording: &Path) -> PathBuf {
    recording.with_extension("html")
}

/// Writes the page.
///
/// # Errors
/// The file cannot be written.
pub fn write_page(path: &Path, page: &str) -> Result<(), ReportError> {
    fs::write(path, page).map_err(|source| ReportError::Page {
        page: path.to_owned(),
        source,
    })
}
