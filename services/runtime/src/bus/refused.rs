//! Names of refused second publishers: an id is translated to the name in the service's health
//! message.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tangent_schemas::topics;

use super::error::BusError;
use super::reader::Handle;
use super::source::Rival;
use super::{Bus, Inner};

/// Largest number of buses whose names are kept: more than a cell has. Health messages of unknown
/// processes cannot grow the map beyond it.
const NAMES_MAX: usize = 128;

/// Names of services, by the part of a publisher's id that stands for its bus.
pub(super) type Names = Arc<Mutex<BTreeMap<[u8; 8], String>>>;

/// A topic on which a publisher was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// Key or pattern of the reader.
    pub topic: String,
    /// Name of the publisher that is refused now; `None` if it is not known, or none is refused
    /// now.
    pub who: Option<String>,
    /// Whether it uses the id of the accepted publisher.
    pub forged: bool,
    /// Number of samples refused since the reader was created.
    pub samples: u64,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let who = self.who.as_deref().unwrap_or("one without a name");
        if self.forged {
            write!(
                f,
                "{}: two publishers use the id of {who}; samples of both are refused ({} samples)",
                self.topic, self.samples
            )
        } else {
            write!(
                f,
                "{}: a second publisher, {who}, is refused ({} samples)",
                self.topic, self.samples
            )
        }
    }
}

/// Subscribes to the health of every service.
pub(super) fn learn(bus: &Bus) -> Result<Handle, BusError> {
    let names = Arc::clone(&bus.inner.names);
    bus.on(&topics::HEALTHS, move |health| {
        let mut names = names.lock().unwrap_or_else(PoisonError::into_inner);
        let key = bus_of(health.publisher);
        if names.len() < NAMES_MAX && !names.contains_key(&key) {
            let name = format!("{}/{}", health.message.service, health.message.instance);
            names.insert(key, name);
        }
    })
}

fn bus_of(publisher: [u8; 16]) -> [u8; 8] {
    let mut part = [0; 8];
    part.copy_from_slice(&publisher[..8]);
    part
}

/// Refused publishers, one entry per topic.
pub(super) fn list(bus: &Inner) -> Vec<Refused> {
    let mut all: BTreeMap<String, Refused> = BTreeMap::new();
    for (topic, rival, samples) in bus.registry.rivals(Instant::now()) {
        let one = all.entry(topic.clone()).or_insert(Refused {
            topic,
            who: None,
            forged: false,
            samples: 0,
        });
        one.samples = one.samples.max(samples);
        if let Some(Rival { publisher, forged }) = rival {
            one.forged |= forged;
            one.who = Some(name(bus, publisher));
        }
    }
    all.into_values().collect()
}

fn name(bus: &Inner, publisher: [u8; 16]) -> String {
    let names = bus.names.lock().unwrap_or_else(PoisonError::into_inner);
    names.get(&bus_of(publisher)).cloned().unwrap_or_else(|| {
        let id: String = publisher.iter().map(|byte| format!("{byte:02x}")).collect();
        format!("id {id}, which is no service of this cell")
    })
}
