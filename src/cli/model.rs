//! `tangent model`.

use std::path::PathBuf;

use clap::Subcommand;

/// What to do with robot models.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// List the built-in models.
    List,
    /// Show the data of a model, given by its name or a file.
    Show {
        /// Name or file.
        name: String,
    },
    /// Print the URDF of a model, given by its name or a file. Viewers of a cell get it with
    /// sensor, tool and camera on /robot_description.
    Urdf {
        /// Name or file.
        name: String,
    },
    /// Compare with reference values and print the largest relative differences.
    Check {
        /// Reference values (JSON).
        file: PathBuf,
        /// Model file to check instead of the built-in models; may be repeated.
        #[arg(long)]
        model: Vec<PathBuf>,
    },
}
