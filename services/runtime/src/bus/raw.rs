//! Encoded messages of every kind, for the recorder.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;

use super::Inner;
use super::error::BusError;
use super::guard::{Guard, Verdict};
use super::keys::Keys;
use super::reader::{Arrival, Counts, Handle};
use super::registry::{add_raw, parse_key};
use super::sleeper::{Sleeper, sleep_for};

/// Publishers of a whole cell that can be told apart at once.
const PUBLISHERS: usize = 256;

/// One message as it is on the wire.
#[derive(Clone, Debug)]
pub struct RawMessage {
    /// Relative to the cell's namespace.
    pub key: Arc<str>,
    /// `PACKAGE/msg/NAME`; empty when the publisher does not say.
    pub type_name: Cow<'static, str>,
    /// CDR with its encapsulation header.
    pub payload: Arc<[u8]>,
    /// Counts its publisher's messages from 1; 0 when the publisher does not say.
    pub sequence: u64,
    /// When it was published, ns since the Unix epoch on the publisher's host.
    pub source_time_ns: i64,
    /// Its publisher's id.
    pub publisher: [u8; 16],
    /// When it arrived here.
    pub received: Instant,
    /// The same in ns since the Unix epoch.
    pub received_ns: i64,
}

impl RawMessage {
    pub(crate) fn arrived(key: &str, type_name: String, at: Arrival<'_>) -> Self {
        Self {
            key: Arc::from(key),
            type_name: Cow::Owned(type_name),
            payload: Arc::from(at.payload),
            sequence: at.attachment.sequence,
            source_time_ns: at.attachment.source_time_ns,
            publisher: at.attachment.publisher,
            received: at.received,
            received_ns: at.received_ns,
        }
    }
}

pub(crate) struct RawCore {
    queue: ArrayQueue<RawMessage>,
    sleeper: Sleeper,
    guard: Mutex<Guard>,
    keys: Mutex<Keys>,
    received: AtomicU64,
    dropped: AtomicU64,
    missing: AtomicU64,
    overtaken: AtomicU64,
    pushed_out: Mutex<HashMap<[u8; 16], PushedOut>>,
}

/// Messages of one publisher that went from a full queue unread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PushedOut {
    /// Their key.
    pub key: Arc<str>,
    /// The publisher's id.
    pub publisher: [u8; 16],
    /// The first one's sequence.
    pub from: u64,
    /// The last one's.
    pub to: u64,
}

impl RawCore {
    fn keys(&self) -> MutexGuard<'_, Keys> {
        self.keys.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn remark(&self) -> Option<String> {
        self.keys().remark()
    }

    fn pushed_out(&self) -> MutexGuard<'_, HashMap<[u8; 16], PushedOut>> {
        self.pushed_out
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn remember(&self, message: &RawMessage) {
        let mut all = self.pushed_out();
        if let Some(known) = all.get_mut(&message.publisher) {
            known.to = known.to.max(message.sequence);
        } else if all.len() < PUBLISHERS {
            let one = PushedOut {
                key: Arc::clone(&message.key),
                publisher: message.publisher,
                from: message.sequence,
                to: message.sequence,
            };
            all.insert(message.publisher, one);
        }
    }

    pub(crate) fn deliver(&self, message: RawMessage) {
        if !self.keys().admit(&message.key) {
            return;
        }
        let attachment = super::attachment::Attachment {
            sequence: message.sequence,
            source_time_ns: message.source_time_ns,
            publisher: message.publisher,
        };
        let verdict = self
            .guard
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .judge(&attachment, message.received_ns, None);
        // A recording keeps what came, in the order it came; it only counts what is odd.
        match verdict {
            Verdict::Accept { missing } => self.missing.fetch_add(missing, Ordering::Relaxed),
            _ => self.overtaken.fetch_add(1, Ordering::Relaxed),
        };
        self.received.fetch_add(1, Ordering::Relaxed);
        if let Some(oldest) = self.queue.force_push(message) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            self.remember(&oldest);
        }
        self.sleeper.wake();
    }
}

pub(crate) fn deliver(readers: &[Arc<RawCore>], message: &RawMessage) {
    for reader in readers {
        reader.deliver(message.clone());
    }
}

pub(crate) fn subscribe(
    bus: &Arc<Inner>,
    patterns: &[String],
    capacity: usize,
) -> Result<RawSubscription, BusError> {
    let core = Arc::new(RawCore {
        queue: ArrayQueue::new(capacity.max(1)),
        sleeper: Sleeper::default(),
        guard: Mutex::new(Guard::for_publishers(PUBLISHERS)),
        keys: Mutex::new(Keys::new(bus.name.is_empty())),
        received: AtomicU64::new(0),
        dropped: AtomicU64::new(0),
        missing: AtomicU64::new(0),
        overtaken: AtomicU64::new(0),
        pushed_out: Mutex::default(),
    });
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

/// Encoded messages through a bounded queue; never holds a publisher up.
pub struct RawSubscription {
    core: Arc<RawCore>,
    _handles: Vec<Handle>,
}

impl RawSubscription {
    /// The oldest message that waits, if one does.
    pub fn try_recv(&self) -> Option<RawMessage> {
        self.core.queue.pop()
    }

    /// The oldest message, waiting for it at most so long. For one thread at a time.
    pub fn recv_timeout(&self, timeout: Duration) -> Option<RawMessage> {
        sleep_for(&self.core.queue, &self.core.sleeper, timeout)
    }

    /// Messages that wait.
    pub fn waiting(&self) -> usize {
        self.core.queue.len()
    }

    /// Whether messages on this key are followed: as many keys are as a reader of patterns follows.
    pub fn follows(&self, key: &str) -> bool {
        self.core.keys().admit(key)
    }

    /// What went from the full queue unread since the last call.
    pub fn pushed_out(&self) -> Vec<PushedOut> {
        self.core.pushed_out().drain().map(|(_, one)| one).collect()
    }

    /// What happened to this reader's messages; odd ones (`overtaken`) are delivered all the same.
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

    /// Messages that were not read: never came, or pushed out of the full queue.
    pub fn lost(&self) -> u64 {
        let counts = self.counts();
        counts.missing + counts.dropped
    }
}
