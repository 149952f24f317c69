//! Outgoing messages: a queue per publisher. The threads of `pump` empty the queues.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use tangent_schemas::topics::Delivery;
use tangent_schemas::{Message, cdr};
use zenoh::key_expr::OwnedKeyExpr;

use super::attachment::Attachment;
use super::history::History;
use super::raw::{self, RawMessage};
use super::reader::Received;
use super::registry::Registry;
use super::remote_publisher::RemotePublisher;
use crate::ring::Ring;

/// Number of messages that may wait for the publishing thread before the oldest is dropped.
fn capacity<M>(delivery: Delivery) -> usize {
    match delivery {
        // As many as fit into 2 MiB, which is more than a second of raw records at 7 kHz: a
        // recorder needs every one.
        Delivery::RealTime | Delivery::Stream => {
            ((2 << 20) / size_of::<Received<M>>()).clamp(256, 1 << 14)
        }
        Delivery::Background => 64,
        // A newer image is worth more than an older one.
        Delivery::Bulk => 4,
    }
}

/// Outgoing queue of one publisher.
pub(crate) struct Outlet<M> {
    key: OwnedKeyExpr,
    delivery: Delivery,
    publisher: [u8; 16],
    queue: Ring<Received<M>>,
    remote: Option<RemotePublisher>,
    registry: Arc<Registry>,
    dropped: Arc<AtomicU64>,
    closed: AtomicBool,
}

impl<M: Message> Outlet<M> {
    /// `dropped` counts the messages that the queue has no room for.
    pub(crate) fn new(
        key: OwnedKeyExpr,
        delivery: Delivery,
        remote: Option<RemotePublisher>,
        registry: Arc<Registry>,
        dropped: Arc<AtomicU64>,
        publisher: [u8; 16],
    ) -> Self {
        Self {
            key,
            delivery,
            publisher,
            queue: Ring::new(capacity::<M>(delivery)),
            remote,
            registry,
            dropped,
            closed: AtomicBool::new(false),
        }
    }

    /// Whether a reader in another process, or a recorder in this one, reads this topic. No lock.
    pub(crate) fn is_wanted(&self) -> bool {
        self.is_wanted_remotely() || self.registry.has_raw_readers()
    }

    /// Whether to queue messages: the topic is read now, or may be asked for later. No lock.
    pub(crate) fn takes(&self) -> bool {
        self.keeps() || self.is_wanted()
    }

    fn keeps(&self) -> bool {
        self.remote.as_ref().is_some_and(RemotePublisher::keeps)
    }

    pub(crate) fn is_wanted_remotely(&self) -> bool {
        self.remote.as_ref().is_some_and(RemotePublisher::matches)
    }

    /// Queues a message for the publishing thread. Takes no lock and allocates nothing.
    pub(crate) fn push(&self, received: Received<M>) {
        self.queue.force_push(received, |_| {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        });
    }

    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
    }
}

/// An outlet without its message type.
pub(crate) trait AnyOutlet: Send + Sync {
    fn delivery(&self) -> Delivery;
    /// The publisher's id.
    fn publisher(&self) -> [u8; 16];
    /// Sends the oldest waiting message, and keeps it in `history` if it may be asked for later;
    /// false if none waits.
    fn send_one(&self, scratch: &mut Vec<u8>, history: &mut History) -> bool;
    /// Whether its publisher was dropped and everything is sent.
    fn is_done(&self) -> bool;
}

impl<M: Message> AnyOutlet for Outlet<M> {
    fn delivery(&self) -> Delivery {
        self.delivery
    }

    fn publisher(&self) -> [u8; 16] {
        self.publisher
    }

    fn send_one(&self, scratch: &mut Vec<u8>, history: &mut History) -> bool {
        let Some(received) = self.queue.pop() else {
            return false;
        };
        if let Err(error) = cdr::encode(&received.message, scratch) {
            tracing::warn!("{}: a message cannot be encoded: {error}", self.key);
            return true;
        }
        let attachment = Attachment {
            sequence: received.sequence,
            source_time_ns: received.source_time_ns,
            publisher: received.publisher,
        };
        if self.keeps() {
            history.keep(&attachment, scratch, received.received);
        }
        if let Some(remote) = self.remote.as_ref().filter(|remote| remote.matches()) {
            remote.put(scratch, attachment);
        }
        if self.registry.has_raw_readers() {
            let readers = self.registry.raw_readers(&self.key);
            if !readers.is_empty() {
                raw::deliver(
                    &readers,
                    &RawMessage {
                        key: Arc::from(self.key.as_str()),
                        type_name: M::NAME.into(),
                        payload: Arc::from(scratch.as_slice()),
                        sequence: received.sequence,
                        source_time_ns: received.source_time_ns,
                        publisher: received.publisher,
                        received: received.received,
                        received_ns: received.source_time_ns,
                    },
                );
            }
        }
        true
    }

    fn is_done(&self) -> bool {
        self.closed.load(Ordering::Acquire) && self.queue.is_empty()
    }
}
