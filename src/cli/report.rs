//! `tangent report`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent report`.
#[derive(Debug, Args)]
pub struct Report {
    /// Recording (`.mcap`), or a folder, for its newest recording.
    pub file: PathBuf,
    /// File for the page; by default beside the recording.
    #[arg(long)]
    pub html: Option<PathBuf>,
    /// Write no page.
    #[arg(long)]
    pub no_html: bool,
    /// Open the page with the desktop's browser.
    #[arg(long, conflicts_with = "no_html")]
    pub open: bool,
}
