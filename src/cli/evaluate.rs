//! `tangent evaluate` and `tangent reproduce`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent evaluate`.
#[derive(Debug, Args)]
pub struct Evaluate {
    /// Name of a scenario in `scenarios/`, or a file; `list` prints all names.
    pub scenario: String,
    /// Estimator in place of the scenario's.
    #[arg(long)]
    pub estimator: Option<String>,
    /// Controller preset in place of the scenario's.
    #[arg(long)]
    pub controller: Option<String>,
    /// Seed in place of the scenario's.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Override one key of the scenario, `KEY.PATH=VALUE`; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// Options of `tangent reproduce`.
#[derive(Debug, Args)]
pub struct Reproduce {
    /// The paper to reproduce.
    #[arg(value_parser = ["tugal", "karacan", "lippiello", "all"])]
    pub paper: String,
    /// Seeds per row: 5 for `tugal` and 10 for `karacan`, whose figures are means over them, 20 for
    /// `lippiello`, whose figures are medians.
    #[arg(long)]
    pub seeds: Option<u64>,
    /// Also draw the paper's figures beside ours as SVG files into this folder (`karacan`,
    /// `lippiello`).
    #[arg(long, value_name = "FOLDER")]
    pub figures: Option<PathBuf>,
}
