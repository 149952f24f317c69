//! `tangent doctor`: checks whether this machine can run a cell, and prints what to change if it
//! cannot.

use anyhow::Result;
use tangent_doctor::{Level, Scope, examine};
use tangent_runtime::CellConfig;

use crate::cli::Doctor;
use crate::output::{Outcome, print_json};

/// Runs all checks. Exit code 1 if there is a problem, 0 if there are only warnings.
///
/// # Errors
/// The diagnosis cannot be written as JSON.
pub fn run(args: &Doctor, config: &CellConfig, json: bool) -> Result<Outcome> {
    let scope = if args.machine {
        Scope::Machine
    } else {
        Scope::Cell
    };
    let diagnosis = examine(config, scope);
    if json {
        print_json(&diagnosis)?;
    } else {
        print!("{diagnosis}");
    }
    Ok(match diagnosis.verdict {
        Level::Problem => Outcome::Failed,
        Level::Ok | Level::Warning => Outcome::Done,
    })
}
