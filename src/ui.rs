//! `tangent ui`: the operator's page, in a process of its own.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use serde_json::json;
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, Role, Stop, ending, watchdog};
use tangent_ui::access::{self, Role as PageRole};
use tangent_ui::{Config, Reporter};

use crate::cli::{Ui, UiRole};
use crate::output::{Outcome, bad_usage, print_json};

/// Name of the person whose token is valid for one run of the page.
const LOCAL: &str = "local";

/// Serves the page until SIGINT or SIGTERM, or gives a person a token.
///
/// # Errors
/// The address or the file of the tokens cannot be used, or the cell cannot be reached.
pub fn run(args: &Ui, mut cell: CellConfig, json: bool) -> Result<Outcome> {
    if let Some(name) = &args.new_token {
        return new_token(name, args.role, &cell, json);
    }
    cell.ui.address = args.address.unwrap_or(cell.ui.address);
    let model = tangent_compose::model(&cell)?;
    let mut config = Config::from_cell(&cell, &model).map_err(bad_usage)?;
    // Without people of its own, the page is for whoever started it.
    let token = match config.tokens.is_empty() {
        true => Some(
            config
                .tokens
                .add_for_this_process(LOCAL, PageRole::Engineer)?,
        ),
        false => None,
    };
    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    ending::in_order(&stop);
    cell.zenoh
        .identify(&roles::identity(tangent_ui::SERVICE, &cell.cell.name));
    // Pages are for people: they need no real-time priority.
    cell.realtime.enabled = false;
    let bus = Bus::open_until(&cell, Role::Client, None, &stop)?;
    watchdog::watch(&stop, None).context("starting the watchdog")?;
    let reporter: Reporter = Arc::new(|recording: &Path| {
        tangent_report::write_for(&[recording.to_owned()])
            .map(|(_, page)| page)
            .map_err(|error| error.to_string())
    });
    tangent_ui::run(config, &bus, &stop, Some(reporter), |address| {
        let mut page = format!("http://{address}/");
        if let Some(token) = &token {
            page += &format!("#token={token}");
        }
        // The address is also for programs, which read the first line.
        let printed = if json {
            print_json(&json!({ "page": page }))
        } else {
            println!("{page}");
            Ok(())
        };
        if let Err(error) = printed {
            tracing::warn!("the page's address cannot be printed: {error:#}");
        }
        if args.open
            && let Err(error) = open::that(&page)
        {
            tracing::warn!("no browser was opened: {error}");
        }
    })?;
    bus.close();
    Ok(Outcome::Done)
}

fn new_token(name: &str, role: UiRole, cell: &CellConfig, json: bool) -> Result<Outcome> {
    let Some(file) = &cell.ui.tokens else {
        return Err(bad_usage(
            "[ui] tokens is not set: name the file in the cell file, as in tokens = \"ui_tokens.toml\", and give it with \
             --cell",
        ));
    };
    let role = match role {
        UiRole::Operator => PageRole::Operator,
        UiRole::Engineer => PageRole::Engineer,
    };
    let token = access::new_person(file, name, role).map_err(bad_usage)?;
    if json {
        print_json(&json!({ "name": name, "role": role.to_string(), "token": token }))?;
    } else {
        println!("{token}");
        eprintln!(
            "token of {name} ({role}); its digest is in {}. It is shown only once. A running page takes it at its next \
             start",
            file.display()
        );
    }
    Ok(Outcome::Done)
}
