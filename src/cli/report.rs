//! `tangent report`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent report`.
#[derive(Debug, Args)]
pub struct Report {
    /// Recording (`.mcap`), or a folder, for its newest recording; two of them are compared.
    #[arg(value_name = "FILE", required = true, num_args = 1..=2)]
    pub files: Vec<PathBuf>,
    /// Task of the recording, by its number from 1; by default the last one. Given twice, the first
    /// is that of the first file.
    #[arg(long, value_name = "N")]
    pub task: Vec<usize>,
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
