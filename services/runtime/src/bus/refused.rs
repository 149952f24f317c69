//! Who was refused as a second publisher, in words: ids are told by the name that a service's
//! health gives.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tangent_schemas::topics;

use super::error::BusError;
use super::reader::Handle;
use super::source::Rival;
use super::{Bus, Inner};

/// Buses whose names are kept. More than a cell has; strangers' healths do not grow it further.
const NAMES_MAX: usize = 128;

/// Services by the part of a publisher's id that stands for the bus.
pub(super) type Names = Arc<Mutex<BTreeMap<[u8; 8], String>>>;

/// A topic on which somebody was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// Key or pattern of the reader.
    pub topic: String,
    /// The source that is refused now, if known; none when none is.
    pub who: Option<String>,
    /// It uses the id of the publisher that is listened to.
    pub forged: bool,
    /// Samples refused since the reader was made.
    pub samples: u64,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let who = self.who.as_deref().unwrap_or("nobody");
        if self.forged {
            write!(
                f,
                "{}: somebody speaks in the name of {who}; what cannot be told apart is refused ({} samples)",
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

/// Listens to every service's health.
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

/// One per topic.
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
