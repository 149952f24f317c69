//! `tangent run`: services in this process until SIGINT or SIGTERM.

use anyhow::{Context, Result};
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, Role, Stop};

use crate::cli::{Record, Run};
use crate::compose::{self, RecorderExtra};
use crate::output::{Outcome, bad_usage};

/// Runs the named services; the router, if it is among them, in the same session.
///
/// # Errors
/// A service that cannot start, or that ends with an error.
pub fn run(args: &Run, config: &CellConfig) -> Result<Outcome> {
    let role = if args.services.iter().any(|name| name == "router") {
        Role::Router
    } else {
        Role::Client
    };
    let names: Vec<&str> = args.services.iter().map(String::as_str).collect();
    let mut config = config.clone();
    if !args.estimators.is_empty() {
        config.estimators.run.clone_from(&args.estimators);
    }
    // Without a role that covers them all, the cell file must name one certificate, or --identity.
    if let Some(role) = roles::role_of(&names) {
        let identity = roles::identity(role, &config.cell.name);
        config.zenoh.identify(&identity);
    }
    if role == Role::Router && names.contains(&"recorder") && !config.recorder.cells.is_empty() {
        return Err(bad_usage(
            "run the recorder of several cells ([recorder] cells) in a process of its own, not in the router's",
        ));
    }
    services(&args.services, &config, role, &RecorderExtra::default())
}

/// Records the cell until Ctrl-C.
///
/// # Errors
/// When the recorder cannot start.
pub fn record(args: &Record, config: &CellConfig) -> Result<Outcome> {
    let extra = RecorderExtra {
        folder: Some(args.folder.clone()),
        attachments: Vec::new(),
    };
    let mut config = config.clone();
    config.zenoh.identify("recorder");
    services(&["recorder".to_owned()], &config, Role::Client, &extra)
}

fn services(
    names: &[String],
    config: &CellConfig,
    role: Role,
    extra: &RecorderExtra,
) -> Result<Outcome> {
    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    let bus = Bus::open_until(config, role, None, &stop)?;
    let mut running = Vec::new();
    for name in names {
        match name.as_str() {
            "router" => {}
            "simulator" => running.push(compose::simulator(config, None, &bus, &stop)?),
            // Registered before the bridge, a controller answers each packet within the bridge's own publish.
            name => running.push(compose::service(name, config, &bus, &stop, extra)?),
        }
    }
    tracing::info!("cell {}: {} running", config.cell.name, names.join(", "));
    while !stop.wait(std::time::Duration::from_secs(3600)) {}
    let mut ended = Ok(());
    for service in running {
        let one = service.end();
        if ended.is_ok() {
            ended = one;
        }
    }
    ended.map(|()| Outcome::Done)
}
