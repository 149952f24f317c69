//! `tangent health`: is a service well? For container engines and scripts: the answer is the exit
//! code.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Result;
use serde::Serialize;
use tangent_runtime::health::host_name;
use tangent_runtime::{CellConfig, State};
use tangent_schemas::tangent;
use tangent_schemas::topics;

use crate::cell;
use crate::cli::Health;
use crate::output::{Outcome, print_json};
use crate::status::state_text;

/// Health comes once a second: after this long every instance was heard.
const LISTEN: Duration = Duration::from_millis(1500);
/// The router's place among the services: it is well when it lets us in.
const ROUTER: &str = "router";

#[derive(Serialize)]
struct Verdict {
    healthy: bool,
    services: Vec<Service>,
}

/// One instance; without one, a service that was not heard.
#[derive(Serialize)]
struct Service {
    name: String,
    healthy: bool,
    instance: Option<String>,
    host: Option<String>,
    state: &'static str,
    fault: Option<String>,
}

/// Asks after the named services: exit code 0 when all are well, 1 when one is not, or the router
/// does not answer.
///
/// # Errors
/// When the cell cannot be reached.
pub fn run(args: &Health, config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = cell::join(config)?;
    let healths = bus.subscribe(&topics::HEALTHS, 256)?;
    let names: Vec<&String> = args.services.iter().filter(|n| *n != ROUTER).collect();
    let here = host_name();
    let mut heard: BTreeMap<(String, String), tangent::Health> = BTreeMap::new();
    let (began, patience) = (Instant::now(), Duration::from_secs_f64(args.patience_s));
    loop {
        let missing = names
            .iter()
            .any(|name| !heard.keys().any(|(service, _)| service == *name));
        // On this host there is one instance of each; elsewhere there may be more to hear.
        let enough = args.here || names.is_empty() || began.elapsed() >= LISTEN;
        let left = patience.saturating_sub(began.elapsed());
        if (!missing && enough) || left.is_zero() {
            break;
        }
        let slice = left.min(Duration::from_millis(100));
        if let Some(received) = healths.recv_timeout(slice) {
            let h = received.message;
            let wanted = names.iter().any(|name| h.service.as_str() == name.as_str());
            if wanted && (!args.here || h.host.as_str() == here) {
                heard.insert((h.service.to_string(), h.instance.to_string()), h);
            }
        }
    }
    let verdict = judge(&args.services, heard.into_values(), args.patience_s);
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

fn judge(
    names: &[String],
    heard: impl Iterator<Item = tangent::Health>,
    patience_s: f64,
) -> Verdict {
    let mut services: Vec<Service> = heard
        .map(|h| Service {
            name: h.service.to_string(),
            healthy: h.state == State::Running as u8 || h.state == State::Degraded as u8,
            instance: Some(h.instance.to_string()),
            host: Some(h.host.to_string()),
            state: state_text(h.state),
            fault: (!h.fault.is_empty()).then_some(h.fault),
        })
        .collect();
    for name in names {
        if services.iter().any(|s| s.name == *name) {
            continue;
        }
        let router = name == ROUTER;
        services.push(Service {
            name: name.clone(),
            healthy: router,
            instance: None,
            host: None,
            state: if router { "running" } else { "silent" },
            fault: (!router).then(|| format!("not heard within {patience_s} s")),
        });
    }
    Verdict {
        healthy: services.iter().all(|s| s.healthy),
        services,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_schemas::convert::cut;

    fn health(service: &str, state: State) -> tangent::Health {
        tangent::Health {
            service: cut(service),
            instance: cut("host-1"),
            state: state as u8,
            ..tangent::Health::default()
        }
    }

    fn verdict(names: &[&str], heard: &[(&str, State)]) -> Verdict {
        let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        judge(&names, heard.iter().map(|(n, s)| health(n, *s)), 3.0)
    }

    #[test]
    fn running_and_degraded_services_are_well() {
        let both = [("rtde", State::Running), ("controller", State::Degraded)];
        assert!(verdict(&["rtde", "controller"], &both).healthy);
        for bad in [State::Starting, State::Fault, State::Stopping] {
            assert!(!verdict(&["rtde"], &[("rtde", bad)]).healthy, "{bad:?}");
        }
    }

    #[test]
    fn one_ill_instance_is_enough_and_silence_is_ill() {
        let mixed = [("estimator", State::Running), ("estimator", State::Fault)];
        assert!(!verdict(&["estimator"], &mixed).healthy);
        let silent = verdict(&["router", "netft"], &[]);
        assert!(!silent.healthy);
        assert!(silent.services[0].healthy, "the router let us in");
        assert_eq!(silent.services[1].state, "silent");
    }
}
