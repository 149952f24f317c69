//! Encoded messages of every kind, and where a reader's wait.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crossbeam_queue::ArrayQueue;

use super::guard::{Guard, Verdict};
use super::keys::Keys;
use super::reader::Arrival;
use super::sleeper::Sleeper;

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
    pub(super) queue: ArrayQueue<RawMessage>,
    pub(super) sleeper: Sleeper,
    guard: Mutex<Guard>,
    keys: Mutex<Keys>,
    pub(super) received: AtomicU64,
    pub(super) dropped: AtomicU64,
    pub(super) missing: AtomicU64,
    pub(super) overtaken: AtomicU64,
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
    /// Holds `capacity` messages; `whole_cells` where keys begin with cells' names.
    pub(super) fn new(capacity: usize, whole_cells: bool) -> Self {
        Self {
            queue: ArrayQueue::new(capacity.max(1)),
            sleeper: Sleeper::default(),
            guard: Mutex::new(Guard::for_publishers(PUBLISHERS)),
            keys: Mutex::new(Keys::new(whole_cells)),
            received: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            missing: AtomicU64::new(0),
            overtaken: AtomicU64::new(0),
            pushed_out: Mutex::default(),
        }
    }

    pub(super) fn keys(&self) -> MutexGuard<'_, Keys> {
        self.keys.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn remark(&self) -> Option<String> {
        self.keys().remark()
    }

    pub(super) fn pushed_out(&self) -> MutexGuard<'_, HashMap<[u8; 16], PushedOut>> {
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
