//! `tangent evaluate` and `tangent reproduce`.

use std::path::PathBuf;

use clap::Args;
use tangent_simulation::suite::SurfaceKind;

/// Options of `tangent evaluate`.
#[derive(Debug, Args)]
pub struct Evaluate {
    /// Name of a scenario in `scenarios/`, or a file; `list` prints all names.
    #[arg(required_unless_present = "suite", conflicts_with = "suite")]
    pub scenario: Option<String>,
    #[command(flatten)]
    pub suite: SuiteOptions,
    /// Estimator in place of the scenario's.
    #[arg(long)]
    pub estimator: Option<String>,
    /// Controller preset in place of the scenario's.
    #[arg(long)]
    pub controller: Option<String>,
    /// Seed in place of the scenario's; of a suite, the seed of its draws (1).
    #[arg(long)]
    pub seed: Option<u64>,
    /// Override one key of the scenario, or of every draw of a suite, `KEY.PATH=VALUE`; may be
    /// repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Run the scenario N times over the same part, each pass with what the passes before learnt,
    /// and print one row per pass; pass i has the seed plus i - 1.
    #[arg(long, value_name = "N", conflicts_with = "suite", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub passes: Option<u32>,
}

/// Options of `tangent evaluate --suite`.
#[derive(Debug, Args)]
pub struct SuiteOptions {
    /// Run random cells and tasks instead of one scenario.
    #[arg(long, value_parser = ["contact"])]
    pub suite: Option<String>,
    /// Number of draws per surface.
    #[arg(long, requires = "suite", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    pub draws: u64,
    /// Run only the part `I` of `N` of the draws, for several machines.
    #[arg(long, requires = "suite", value_name = "I/N", value_parser = shard)]
    pub shard: Option<(u64, u64)>,
    /// Run only this surface.
    #[arg(long, requires = "suite", value_parser = surface)]
    pub surface: Option<SurfaceKind>,
    /// Run only this draw and print the figures of a single scenario.
    #[arg(long, requires = "surface", value_name = "K")]
    pub draw: Option<u64>,
    /// Also write one line per draw to this file.
    #[arg(long, requires = "suite", value_name = "FILE", conflicts_with = "draw")]
    pub csv: Option<PathBuf>,
    /// Also write a page with the tables and all draws to this file.
    #[arg(long, requires = "suite", value_name = "FILE", conflicts_with = "draw")]
    pub html: Option<PathBuf>,
}

/// Reads `I/N`.
fn shard(text: &str) -> Result<(u64, u64), String> {
    let parts = text.split_once('/');
    let numbers = parts.and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    numbers
        .filter(|(i, n)| (1..=*n).contains(i))
        .ok_or_else(|| "I/N with I from 1 to N, for instance 2/4".to_owned())
}

/// Reads the name of a surface.
fn surface(text: &str) -> Result<SurfaceKind, String> {
    SurfaceKind::from_name(text).ok_or_else(|| {
        let names = SurfaceKind::ALL.map(SurfaceKind::name);
        format!("one of {}", names.join(", "))
    })
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
