//! `tangent health`: checks whether services are healthy, for container engines and scripts. The
//! result is the exit code.

use std::time::Duration;

use anyhow::Result;
use tangent_client::{health, session};
use tangent_runtime::CellConfig;

use crate::cli::Health;
use crate::output::{Outcome, print_json};

/// Checks the named services: exit code 0 if all are healthy, 1 if one is not, or the router does
/// not answer.
///
/// # Errors
/// The cell cannot be reached.
pub fn run(args: &Health, config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = session::join(config)?;
    let patience = Duration::from_secs_f64(args.patience_s);
    let verdict = health::ask_after(&bus, &args.services, args.here, patience)?;
    if json {
        print_json(&verdict)?;
    } else {
        for s in &verdict.services {
            println!(
                "{:<12} {:<9} {} {}",
                s.name,
                s.state,
                s.instance.as_deref().unwrap_or("-"),
                s.fault.as_deref().unwrap_or("")
            );
        }
    }
    Ok(if verdict.healthy {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}
