//! `tangent run`: runs services in this process until SIGINT or SIGTERM.

mod rules;

use anyhow::{Context, Result};
use tangent_compose::RecorderExtra;
use tangent_runtime::security::roles;
use tangent_runtime::systemd::Notify;
use tangent_runtime::{CellConfig, Role, Stop, ending, watchdog};
use tangent_simulated_cell::start_simulator;

use crate::cli::{Record, Run};
use crate::output::{Outcome, bad_usage};
use rules::Rules;

/// Runs the named services; if the router is among them, it uses the same session.
///
/// # Errors
/// A service cannot start, or ends with an error.
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
    // If no single role covers them all, the cell file or --identity must name one certificate.
    if let Some(role) = roles::role_of(&names) {
        let identity = roles::identity(role, &config.cell.name);
        config.zenoh.identify(&identity);
    }
    if role == Role::Router && names.contains(&"recorder") && !config.recorder.cells.is_empty() {
        return Err(bad_usage(
            "run the recorder of several cells ([recorder] cells) in a process of its own, not in the router's",
        ));
    }
    let loops = tangent_ui::NOT_BESIDE;
    if let (true, Some(service)) = (
        names.contains(&tangent_ui::SERVICE),
        names.iter().find(|name| loops.contains(name)),
    ) {
        return Err(bad_usage(format!(
            "run ui in a process of its own, not beside {service}, which belongs to the control loop"
        )));
    }
    services(&args.services, &config, role, &RecorderExtra::default())
}

/// Records the cell until Ctrl-C.
///
/// # Errors
/// The recorder cannot start.
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
    ending::in_order(&stop);
    let mut notify = Some(Notify::from_environment());
    // A process with the router alone restarts its session for new rules; with other services in
    // the process, it would end their session too.
    let mut rules = Rules::of(config, role);
    while serve(names, config, role, extra, &stop, &mut rules, &mut notify)? == Ended::NewRules {
        tracing::warn!("the access rules have changed: the router restarts with them");
    }
    Ok(Outcome::Done)
}

#[derive(PartialEq, Eq)]
enum Ended {
    Asked,
    NewRules,
}

/// Runs the services from the opening of the session to its end.
fn serve(
    names: &[String],
    config: &CellConfig,
    role: Role,
    extra: &RecorderExtra,
    stop: &Stop,
    rules: &mut Rules,
    notify: &mut Option<Option<Notify>>,
) -> Result<Ended> {
    let bus = rules.open(config, role, stop)?;
    // The router publishes its health like any other service.
    let router = match role {
        Role::Router => Some(tangent_compose::router(&bus)?),
        Role::Client => None,
    };
    let mut running = Vec::new();
    for name in names {
        match name.as_str() {
            "router" => {}
            "simulator" => running.push(start_simulator(config, None, &bus, stop)?),
            // Registered before the bridge, a controller answers each packet within the bridge's
            // own publish call.
            name => running.push(tangent_compose::service(name, config, &bus, stop, extra)?),
        }
    }
    tracing::info!("cell {}: {} running", config.cell.name, names.join(", "));
    // Once per process: the loops are monitored from now on, and systemd is notified that they run.
    if let Some(notify) = notify.take() {
        watchdog::watch(stop, notify).context("starting the watchdog")?;
    }
    let alone = running.is_empty();
    let mut ended = Ended::Asked;
    while !stop.wait(rules.period()) {
        match rules.changed(config) {
            Some(Ok(())) if alone => {
                ended = Ended::NewRules;
                break;
            }
            Some(Ok(())) => {
                let words = "the access rules have changed: they take effect at the next start of this process";
                tracing::warn!("{words}");
                if let Some(router) = &router {
                    router.degraded(format_args!("{words}"));
                }
            }
            Some(Err(error)) => {
                tracing::error!(
                    "the access rules have changed, and the new ones are rejected: {error}"
                )
            }
            None => {}
        }
    }
    let mut failed = Ok(());
    for service in running {
        let one = service.end();
        if failed.is_ok() {
            failed = one;
        }
    }
    failed?;
    drop(router);
    bus.close();
    Ok(ended)
}
