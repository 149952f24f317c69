//! `tangent health`: checks whether services are healthy, for container engines and scripts. The
//! result is the exit code.

use std::time::Duration;

use anyhow::Result;
use tangent_client::status::no_such_cell;
use tangent_client::{health, session};
use tangent_runtime::CellConfig;

use crate::cli::Health;
use crate::output::{Outcome, print_json};
use crate::table::Columns;

/// Checks the named services: exit code 0 if all are healthy, 1 if one is not, or the router does
/// not answer.
///
/// # Errors
/// The cell cannot be reached.
pub fn run(args: &Health, config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = session::join(config)?;
    let patience = Duration::from_secs_f64(args.patience_s);
    let verdict = health::ask_after(&bus, &args.services, args.here, patience)?;
    if verdict.services.iter().all(|s| s.instance.is_none())
        && let Some(error) = no_such_cell(config)?
    {
        return Err(error.into());
    }
    if json {
        print_json(&verdict)?;
    } else {
        let mut table = Columns::new(&["service", "state", "instance", "fault"]);
        for s in &verdict.services {
            table.row([
                s.name.as_str(),
                s.state,
                s.instance.as_deref().unwrap_or("-"),
                s.fault.as_deref().unwrap_or_default(),
            ]);
        }
        table.print(0);
    }
    Ok(if verdict.healthy {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}
