//! Encoded messages of any type, and the queue of a reader of such messages.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::guard::{Guard, Verdict};
use super::keys::Keys;
use super::reader::Arrival;
use super::sleeper::Sleeper;
use crate::ring::Ring;

/// Largest number of publishers of a cell that are distinguished at once.
const PUBLISHERS: usize = 256;

/// One message in its encoded form.
#[derive(Clone, Debug)]
pub struct RawMessage {
    /// Key, relative to the cell's namespace.
    pub key: Arc<str>,
    /// `PACKAGE/msg/NAME`; empty if the publisher does not state it.
    pub type_name: Cow<'static, str>,
    /// CDR with its encapsulation header.
    pub payload: Arc<[u8]>,
    /// Sequence number, counted by its publisher from 1; 0 if the publisher does not state it.
    pub sequence: u64,
    /// Time of publication, ns since the Unix epoch on the publisher's host.
    pub source_time_ns: i64,
    /// Id of its publisher.
    pub publisher: [u8; 16],
    /// Time of arrival here.
    pub received: Instant,
    /// Time of arrival here, ns since the Unix epoch.
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
    pub(super) queue: Ring<RawMessage>,
    pub(super) sleeper: Sleeper,
    guard: Mutex<Guard>,
    keys: Mutex<Keys>,
    pub(super) received: AtomicU64,
    pub(super) dropped: AtomicU64,
    pub(super) missing: AtomicU64,
    pub(super) overtaken: AtomicU64,
    pushed_out: Mutex<HashMap<[u8; 16], PushedOut>>,
}

/// Messages of one publisher that were dropped unread from a full queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PushedOut {
    /// Key of the messages.
    pub key: Arc<str>,
    /// Id of the publisher.
    pub publisher: [u8; 16],
    /// Sequence number of the first one.
    pub from: u64,
    /// Sequence number of the last one.
    pub to: u64,
}

impl RawCore {
    /// A reader whose queue holds `capacity` messages; `whole_cells` if keys begin with names of
    /// cells.
    pub(super) fn new(capacity: usize, whole_cells: bool) -> Self {
        Self {
            queue: Ring::new(capacity),
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
        // A recording keeps what arrived, in that order, and only counts irregularities.
        match verdict {
            Verdict::Accept { missing } => self.missing.fetch_add(missing, Ordering::Relaxed),
            _ => self.overtaken.fetch_add(1, Ordering::Relaxed),
        };
        self.received.fetch_add(1, Ordering::Relaxed);
        self.queue.force_push(message, |oldest| {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            self.remember(&oldest);
        });
        self.sleeper.wake();
    }
}

pub(crate) fn deliver(readers: &[Arc<RawCore>], message: &RawMessage) {
    for reader in readers {
        reader.deliver(message.clone());
    }
}
