//! `tangent completions`.

use clap::Args;
use clap_complete::Shell;

/// Options of `tangent completions`.
#[derive(Debug, Args)]
pub struct Completions {
    /// Shell that is to complete the command.
    #[arg(value_enum)]
    pub shell: Shell,
}
