//! `tangent completions`: prints the completions of the command for a shell.

use std::io::{self, Write};

use anyhow::{Context, Result};
use clap::CommandFactory;

use crate::cli::{Cli, Completions};
use crate::output::Outcome;

/// Prints the script that the shell reads at its start.
///
/// # Errors
/// Standard output is not usable.
pub fn run(args: &Completions) -> Result<Outcome> {
    let mut command = Cli::command();
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, name, &mut script);
    io::stdout()
        .write_all(&script)
        .context("writing the completions")?;
    Ok(Outcome::Done)
}
