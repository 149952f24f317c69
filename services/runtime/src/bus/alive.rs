//! Who is here: liveliness tokens `alive/SERVICE/INSTANCE`.
//!
//! A token says that a process's session is connected, not that its thread still works: silence of data is what loops
//! judge by.

use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use tangent_schemas::topics;

use super::Inner;
use super::error::BusError;
use super::registry::parse_concrete_key;
use super::session::Session;

/// Between two looks at who is here.
const LOOK: Duration = Duration::from_millis(100);
/// The router answers who is here at once; it has this long.
const ASK_PATIENCE: Duration = Duration::from_secs(1);
/// One that lost the race for a name is gone by then.
const RIVAL_PATIENCE: Duration = Duration::from_secs(1);

/// A service that is here.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub struct Alive {
    /// Cell; the bus's own, or the one in the key on a bus outside any cell.
    pub cell: String,
    /// For instance `netft`.
    pub service: String,
    /// Tells several of a kind apart: host and process.
    pub instance: String,
}

/// Says that a service is here until it is dropped.
#[must_use = "dropping the token says that the service has gone"]
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

/// The same for a service of which a cell has one. A token that is there is given time to go: its process may have been
/// cut off a moment ago.
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
    // Two that start in the same moment see each other only now. The greater name goes; the lesser waits to see whether
    // the other is one that goes, or one that was there first.
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
    // HOST-PROCESS, as health::instance_name writes it.
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

/// `service` is `*`, or a [`topics::estimator_service`] of `*`.
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

/// `[CELL/]alive/SERVICE/INSTANCE`, or `[CELL/]alive/estimate/NAME/INSTANCE`.
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
