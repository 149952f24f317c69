//! Reasons why there is no report; the messages name the file.

use std::io;
use std::path::PathBuf;

use tangent_recorder::RecorderError;

/// A recording has no report. The cause, if there is one, is the error's source.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file is no recording, or cannot be opened.
    #[error("the report needs a recording (.mcap)")]
    NotARecording(#[source] RecorderError),
    /// The recording holds no messages of a tangent cell.
    #[error(
        "{files}: contains neither /arm/state nor /control/state, but {found}; a report needs a recording that \
         `tangent record`, `tangent run recorder` or `tangent up` made"
    )]
    NoCell {
        /// The files, separated by commas.
        files: String,
        /// Contents found instead.
        found: String,
    },
    /// The recording holds several cells, and none was selected.
    #[error("{file} holds the cells {cells}: choose one with --cell")]
    WhichCell {
        /// The recording.
        file: PathBuf,
        /// Names of the cells, separated by commas.
        cells: String,
    },
    /// The recording has no task of this number.
    #[error("--task {number}: the recording holds {tasks}")]
    NoTask {
        /// The number that was asked for, from 1.
        number: usize,
        /// Tasks of the recording, separated by commas.
        tasks: String,
    },
    /// The folder cannot be listed.
    #[error("listing {folder}")]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The folder has no recording.
    #[error("no recording (.mcap) in {0}")]
    EmptyFolder(PathBuf),
    /// No file was given.
    #[error("there is no recording to report on: the recorder wrote no file")]
    NoFile,
    /// A plot cannot be drawn.
    #[error("plot \"{title}\" could not be drawn: {reason}")]
    Plot {
        /// Title of the plot.
        title: String,
        /// Error of the plotting library.
        reason: String,
    },
    /// The page cannot be written.
    #[error(
        "the page {page} could not be written; choose another file with --html, or write no page with --no-html"
    )]
    Page {
        /// File of the page.
        page: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}
