//! Whether the given services are healthy.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde::Serialize;
use tangent_runtime::health::host_name;
use tangent_runtime::{Bus, State};
use tangent_schemas::tangent;
use tangent_schemas::topics;

use crate::error::ClientError;
use crate::status::state_text;

/// Health is published once a second: within this time, every instance has been received.
const LISTEN: Duration = Duration::from_millis(1500);
/// Name of the router in the list of services: it is healthy if it accepts the connection.
const ROUTER: &str = "router";

/// Health of all requested services.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// Whether every requested service is healthy.
    pub healthy: bool,
    /// Each instance that published its health, and each service that did not.
    pub services: Vec<Service>,
}

/// One instance, or a service without any instance that published its health.
#[derive(Clone, Debug, Serialize)]
pub struct Service {
    /// Name of the service.
    pub name: String,
    /// Whether it runs, degraded or not.
    pub healthy: bool,
    /// `HOST-PID` of its process.
    pub instance: Option<String>,
    /// Host on which it runs.
    pub host: Option<String>,
    /// Its state in words, see [`state_text`].
    pub state: &'static str,
    /// Its fault, if there is one.
    pub fault: Option<String>,
}

/// Waits for the health messages of the named services, for at most `patience`. With `here_only`,
/// only instances on this host count.
///
/// # Errors
/// The bus refuses.
pub fn ask_after(
    bus: &Bus,
    services: &[String],
    here_only: bool,
    patience: Duration,
) -> Result<Verdict, ClientError> {
    let healths = bus.subscribe(&topics::HEALTHS, 256)?;
    let names: Vec<&String> = services.iter().filter(|n| *n != ROUTER).collect();
    let here = host_name();
    let mut heard: BTreeMap<(String, String), tangent::Health> = BTreeMap::new();
    let began = Instant::now();
    loop {
        let missing = names
            .iter()
            .any(|name| !heard.keys().any(|(service, _)| service == *name));
        // On this host there is one instance of each; elsewhere there may be more to wait for.
        let enough = here_only || names.is_empty() || began.elapsed() >= LISTEN;
        let left = patience.saturating_sub(began.elapsed());
        if (!missing && enough) || left.is_zero() {
            break;
        }
        let slice = left.min(Duration::from_millis(100));
        if let Some(received) = healths.recv_timeout(slice) {
            let h = received.message;
            let wanted = names.iter().any(|name| h.service.as_str() == name.as_str());
            if wanted && (!here_only || h.host.as_str() == here) {
                heard.insert((h.service.to_string(), h.instance.to_string()), h);
            }
        }
    }
    let patience_s = patience.as_secs_f64();
    Ok(judge(services, heard.into_values(), patience_s))
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
            fault: (!router).then(|| format!("no health message within {patience_s} s")),
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
    fn one_unhealthy_instance_is_enough_and_silence_is_unhealthy() {
        let mixed = [("estimator", State::Running), ("estimator", State::Fault)];
        assert!(!verdict(&["estimator"], &mixed).healthy);
        let silent = verdict(&["router", "netft"], &[]);
        assert!(!silent.healthy);
        assert!(silent.services[0].healthy, "the router let us in");
        assert_eq!(silent.services[1].state, "silent");
    }
}
