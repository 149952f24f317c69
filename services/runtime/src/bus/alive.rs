//! Which services are running: liveliness tokens `alive/SERVICE/INSTANCE`.
//!
//! A token shows that a process's session is connected, not that its threads still work. Control
//! loops therefore rely on the age of data.

use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use tangent_schemas::topics;

use super::Inner;
use super::error::BusError;
use super::registry::parse_concrete_key;
use super::session::Session;

/// Interval between two checks for other instances.
const LOOK: Duration = Duration::from_millis(100);
/// Longest time to wait for the router's list of tokens; it normally replies at once.
const ASK_PATIENCE: Duration = Duration::from_secs(1);
/// Time within which an instance that lost the race for a name disappears.
const RIVAL_PATIENCE: Duration = Duration::from_secs(1);

/// A running service.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub struct Alive {
    /// Cell: that of the bus, or the one in the key on a bus outside any cell.
    pub cell: String,
    /// Name of the service, such as `netft`.
    pub service: String,
    /// Host and process, which distinguish several instances of a service.
    pub instance: String,
}

/// Declares a service as running until it is dropped.
#[must_use = "dropping the token reports that the service has ended"]
pub struct AliveToken {
    alive: Alive,
    bus: Weak<Inner>,
    _token: Option<zenoh::liveliness::LivelinessToken>,
}

impl Drop for AliveToken {
    fn drop(&mut self) {
        if let Some(bus) = self.bus.upgrade() {
            let mut tokens = bus.lock_tokens();
            if let Some(index) = tokens.iter().position(|alive| *alive == self.alive) {
                tokens.swap_remove(index);
            }
        }
    }
}

pub(crate) fn declare(
    bus: &Arc<Inner>,
    service: &str,
    instance: &str,
) -> Result<AliveToken, BusError> {
    let key = topics::alive(service, instance);
    parse_concrete_key(&key)?;
    let token = match &bus.session {
        Some(session) => Some(session.token(&key)?),
        None => None,
    };
    let alive = Alive {
        cell: bus.name.clone(),
        service: service.to_owned(),
        instance: instance.to_owned(),
    };
    bus.lock_tokens().push(alive.clone());
    Ok(AliveToken {
        alive,
        bus: Arc::downgrade(bus),
        _token: token,
    })
}

/// Declares a service as running that may run only once in a cell. An existing token is given time
/// to expire, as its process may just have been cut off; after that the claim is refused.
pub(crate) fn claim(
    bus: &Arc<Inner>,
    service: &str,
    instance: &str,
) -> Result<AliveToken, BusError> {
    let patience = bus
        .session
        .as_ref()
        .map_or(Duration::ZERO, Session::stale_after);
    let begin = Instant::now();
    loop {
        match others(bus, service, None)?.into_iter().next() {
            None => break,
            Some(other) if bus.is_local(&other) || begin.elapsed() >= patience => {
                return Err(taken(other));
            }
            Some(_) => std::thread::park_timeout(LOOK),
        }
    }
    let token = declare(bus, service, instance)?;
    // Two instances that start at the same moment see each other only now. The one with the greater
    // name gives up. The other one waits, to find out whether its rival gives up or was there
    // first.
    let mut rival = others(bus, service, Some(instance))?.into_iter().next();
    let wait = Instant::now();
    while let Some(other) = rival {
        if instance > other.instance.as_str() || wait.elapsed() >= RIVAL_PATIENCE {
            return Err(taken(other));
        }
        std::thread::park_timeout(LOOK);
        rival = others(bus, service, Some(instance))?.into_iter().next();
    }
    Ok(token)
}

fn others(bus: &Arc<Inner>, service: &str, own: Option<&str>) -> Result<Vec<Alive>, BusError> {
    let mut found = list(bus, service, ASK_PATIENCE)?;
    found.retain(|alive| alive.service == service && Some(alive.instance.as_str()) != own);
    Ok(found)
}

fn taken(other: Alive) -> BusError {
    // HOST-PROCESS, as from `health::instance_name`.
    let host = match other.instance.rsplit_once('-') {
        Some((host, _)) => host.to_owned(),
        None => other.instance.clone(),
    };
    BusError::Taken {
        service: other.service,
        cell: other.cell,
        instance: other.instance,
        host,
    }
}

/// Lists the tokens of `service`, which is `*`, or a [`topics::estimator_service`] of `*`.
pub(crate) fn list(
    bus: &Arc<Inner>,
    service: &str,
    timeout: Duration,
) -> Result<Vec<Alive>, BusError> {
    let mut all = bus.lock_tokens().clone();
    all.retain(|alive| alive.service.contains('/') == service.contains('/'));
    if let Some(session) = &bus.session {
        let outside = bus.name.is_empty();
        let pattern = topics::alive(service, "*");
        let keys = if outside {
            session.tokens(&format!("*/{pattern}"), timeout)?
        } else {
            session.tokens(&pattern, timeout)?
        };
        all.extend(keys.iter().filter_map(|key| parse(key, &bus.name)));
    }
    all.sort();
    all.dedup();
    Ok(all)
}

/// Parses `[CELL/]alive/SERVICE/INSTANCE`, or `[CELL/]alive/estimate/NAME/INSTANCE`.
fn parse(key: &str, cell: &str) -> Option<Alive> {
    let mut parts = key.rsplit('/');
    let (instance, name) = (parts.next()?, parts.next()?);
    let service = match parts.next()? {
        "alive" => name.to_owned(),
        "estimate" if parts.next()? == "alive" => topics::estimator_service(name),
        _ => return None,
    };
    Some(Alive {
        cell: parts.next().unwrap_or(cell).to_owned(),
        service,
        instance: instance.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_inside_and_outside_a_cell() {
        let inside = parse("alive/netft/host-1", "cell1").unwrap();
        assert_eq!(
            (inside.cell.as_str(), inside.service.as_str()),
            ("cell1", "netft")
        );
        let outside = parse("cell2/alive/rtde/host-2", "").unwrap();
        assert_eq!(outside.cell, "cell2");
        assert_eq!(parse("cell2/other/rtde/host-2", ""), None);
        let estimator = parse("alive/estimate/blend/host-3", "cell1").unwrap();
        assert_eq!(estimator.service, "estimate/blend");
        assert_eq!(
            (estimator.cell.as_str(), estimator.instance.as_str()),
            ("cell1", "host-3")
        );
    }
}
