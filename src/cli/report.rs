//! `tangent report`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent report`.
#[derive(Debug, Args)]
pub struct Report {
    /// Recording (`.mcap`), or a folder: its newest recording.
    pub file: PathBuf,
    /// Where to write the page; beside the recording if not named.
    #[arg(long)]
    pub html: Option<PathBuf>,
    /// Write no page.
    #[arg(long)]
    pub no_html: bool,
}
