//! `tangent model`.

use std::path::PathBuf;

use clap::Subcommand;

/// What to do with robot models.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// Names of the built-in models.
    List,
    /// One model's data: a built-in name or a file.
    Show {
        /// Name or file.
        name: String,
    },
    /// Compare with reference values and print the largest relative differences.
    Check {
        /// Reference values (JSON).
        file: PathBuf,
        /// A model file of your own to check instead of the built-in ones; may be repeated.
        #[arg(long)]
        model: Vec<PathBuf>,
    },
}
