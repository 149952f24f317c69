//! `tangent param`.

use clap::Subcommand;

/// What to do with parameters.
#[derive(Debug, Subcommand)]
pub enum ParamCommand {
    /// Print one parameter, or all of a service, or all.
    Get {
        /// `SERVICE/NAME`, `SERVICE`, or nothing.
        name: Option<String>,
    },
    /// Set a parameter; the service ramps to it where a step would jerk the arm.
    Set {
        /// `SERVICE/NAME`.
        name: String,
        /// New value, in the parameter's unit.
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
}
