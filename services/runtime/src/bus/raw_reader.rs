//! Reader of all messages in encoded form, for the recorder.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::Inner;
use super::error::BusError;
use super::raw::{PushedOut, RawCore, RawMessage};
use super::reader::{Counts, Handle};
use super::registry::{add_raw, parse_key};
use super::sleeper::sleep_for;

pub(crate) fn subscribe(
    bus: &Arc<Inner>,
    patterns: &[String],
    capacity: usize,
) -> Result<RawSubscription, BusError> {
    let core = Arc::new(RawCore::new(capacity, bus.name.is_empty()));
    let mut handles = Vec::new();
    for pattern in patterns {
        let mut handle = add_raw(&bus.registry, &parse_key(pattern)?, &core);
        if let Some(session) = &bus.session {
            handle.keep(session.subscribe_raw(pattern, Arc::clone(&core))?);
        }
        handles.push(handle);
    }
    Ok(RawSubscription {
        core,
        _handles: handles,
    })
}

/// Encoded messages through a bounded queue, which never delays a publisher.
pub struct RawSubscription {
    core: Arc<RawCore>,
    _handles: Vec<Handle>,
}

impl RawSubscription {
    /// The oldest waiting message, if there is one.
    pub fn try_recv(&self) -> Option<RawMessage> {
        self.core.queue.pop()
    }

    /// The oldest message, waiting for it for at most `timeout`. For one thread at a time.
    pub fn recv_timeout(&self, timeout: Duration) -> Option<RawMessage> {
        sleep_for(&self.core.queue, &self.core.sleeper, timeout)
    }

    /// Number of waiting messages.
    pub fn waiting(&self) -> usize {
        self.core.queue.len()
    }

    /// Whether messages on this key are followed; the number of keys followed is limited.
    pub fn follows(&self, key: &str) -> bool {
        self.core.keys().admit(key)
    }

    /// Messages dropped unread from the full queue since the last call.
    pub fn pushed_out(&self) -> Vec<PushedOut> {
        self.core.pushed_out().drain().map(|(_, one)| one).collect()
    }

    /// Counts of this reader's messages; those counted as `overtaken` are delivered all the same.
    pub fn counts(&self) -> Counts {
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Counts {
            received: load(&self.core.received),
            missing: load(&self.core.missing),
            dropped: load(&self.core.dropped),
            overtaken: load(&self.core.overtaken),
            new_keys: self.core.keys().refused(),
            ..Counts::default()
        }
    }

    /// Number of messages that were not read: they never arrived, or were dropped from the full
    /// queue.
    pub fn lost(&self) -> u64 {
        let counts = self.counts();
        counts.missing + counts.dropped
    }
}
