//! Publishers of typed and of encoded messages.

use std::cell::{Cell, RefCell};
use std::sync::Arc;
use std::time::Instant;

use tangent_actuation::lease;
use tangent_schemas::Message;
use tangent_schemas::topics::{Delivery, Topic};
use zenoh::key_expr::OwnedKeyExpr;

use super::Inner;
use super::attachment::Attachment;
use super::error::BusError;
use super::outlet::Outlet;
use super::pump::Waker;
use super::raw::{self, RawMessage};
use super::reader::{Arrival, Received};
use super::registry::{Channel, Readers, parse_concrete_key};
use super::remote_publisher::RemotePublisher;
use crate::clock;

/// Publishes one topic from one thread at a time.
///
/// `publish` takes no lock, allocates nothing and never calls Zenoh. The exception is the first
/// call after the readers in this process have changed, which looks them up again. Messages that
/// own memory (`Vec`, `String`) allocate when they are copied; those of the control loop own none.
pub struct Publisher<M: Message> {
    channel: Arc<Channel<M>>,
    known: RefCell<(u64, Readers<M>)>,
    sequence: Cell<u64>,
    id: [u8; 16],
    mark: [u8; 16],
    outlet: Arc<Outlet<M>>,
    pump: Waker,
    // Keeps the bus alive as long as its publishers.
    _bus: Arc<Inner>,
}

impl<M: Message> Publisher<M> {
    pub(crate) fn declare(bus: &Arc<Inner>, topic: &Topic<M>) -> Result<Self, BusError> {
        let key = parse_concrete_key(topic.key())?;
        let channel = bus.registry.channel::<M>(&key)?;
        let id = bus.ids.next();
        let pump = bus.pump.waker(topic.delivery());
        let remote = match &bus.session {
            Some(session) => {
                // Images are too large to be kept.
                let kept = topic.delivery() != Delivery::Bulk;
                let questions = kept
                    .then(|| bus.questions(key.as_str(), M::NAME, id, pump.thread()))
                    .flatten();
                Some(session.publisher(&key, topic.delivery(), M::NAME, questions)?)
            }
            None => None,
        };
        let outlet = Arc::new(Outlet::new(
            key,
            topic.delivery(),
            remote,
            Arc::clone(&bus.registry),
            bus.pump.drops(),
            id,
        ));
        bus.pump.add(Arc::clone(&outlet) as _);
        Ok(Self {
            known: RefCell::new((channel.generation(), channel.readers())),
            channel,
            sequence: Cell::new(0),
            mark: lease::mark(&id),
            id,
            outlet,
            pump,
            _bus: Arc::clone(bus),
        })
    }

    /// Delivers to every reader in this process, callbacks first and in this thread. Then queues
    /// the message for the publishing thread, if there are other readers. Returns the sequence
    /// number of the message.
    pub fn publish(&self, message: &M) -> u64 {
        let sequence = self.sequence.get() + 1;
        self.sequence.set(sequence);
        let readers = self.readers();
        let wanted = self.outlet.takes();
        if readers.is_empty() && !wanted {
            return sequence;
        }
        let received = Received {
            message: message.clone(),
            sequence,
            source_time_ns: clock::now_ns(),
            received: Instant::now(),
            publisher: self.id,
        };
        for reader in readers.iter() {
            reader.deliver_near(&received);
        }
        if wanted {
            self.outlet.push(received);
            self.pump.queued();
        }
        sequence
    }

    /// The readers as of the last look-up, which is repeated after a change.
    fn readers(&self) -> Readers<M> {
        let generation = self.channel.generation();
        let mut known = self.known.borrow_mut();
        if known.0 != generation {
            *known = (generation, self.channel.readers());
        }
        Arc::clone(&known.1)
    }

    /// This publisher's id, as its readers see it.
    pub fn id(&self) -> [u8; 16] {
        self.id
    }

    /// The [`lease::mark`] of this publisher's id.
    pub fn mark(&self) -> [u8; 16] {
        self.mark
    }

    /// Sequence number of the last message; 0 before the first.
    pub fn sequence(&self) -> u64 {
        self.sequence.get()
    }

    /// Whether another process reads this topic now.
    pub fn is_read_remotely(&self) -> bool {
        self.outlet.is_wanted_remotely()
    }

    /// Whether this or another process reads this topic now.
    pub fn is_read(&self) -> bool {
        !self.readers().is_empty() || self.outlet.is_wanted()
    }
}

impl<M: Message> Drop for Publisher<M> {
    fn drop(&mut self) {
        self.outlet.close();
        self.pump.wake();
    }
}

/// Publishes messages that are already encoded.
pub struct RawPublisher {
    key: OwnedKeyExpr,
    type_name: String,
    sequence: Cell<u64>,
    id: [u8; 16],
    remote: Option<RemotePublisher>,
    bus: Arc<Inner>,
}

impl RawPublisher {
    pub(crate) fn declare(bus: &Arc<Inner>, key: &str, type_name: &str) -> Result<Self, BusError> {
        let key = parse_concrete_key(key)?;
        let remote = match &bus.session {
            Some(session) => Some(session.publisher(&key, Delivery::Stream, type_name, None)?),
            None => None,
        };
        Ok(Self {
            key,
            type_name: type_name.to_owned(),
            sequence: Cell::new(0),
            id: bus.ids.next(),
            remote,
            bus: Arc::clone(bus),
        })
    }

    /// Sends CDR bytes (with their encapsulation header) to all readers of the key, in this thread.
    pub fn publish(&self, payload: &[u8]) {
        let sequence = self.sequence.get() + 1;
        self.sequence.set(sequence);
        self.publish_as(payload, self.id, sequence);
    }

    /// Sends CDR bytes (with their encapsulation header) under the id and sequence number of
    /// another publisher, for a tool that stands in for it.
    pub fn publish_as(&self, payload: &[u8], publisher: [u8; 16], sequence: u64) {
        let attachment = Attachment {
            sequence,
            source_time_ns: clock::now_ns(),
            publisher,
        };
        let arrival = Arrival {
            near: true,
            ..Arrival::now(payload, attachment)
        };
        self.bus
            .registry
            .deliver_encoded(&self.key, &self.type_name, arrival);
        let readers = self.bus.registry.raw_readers(&self.key);
        if !readers.is_empty() {
            raw::deliver(
                &readers,
                &RawMessage::arrived(self.key.as_str(), self.type_name.clone(), arrival),
            );
        }
        if let Some(remote) = &self.remote {
            remote.put(payload, attachment);
        }
    }

    /// Whether another process reads this topic now.
    pub fn is_read_remotely(&self) -> bool {
        self.remote.as_ref().is_some_and(RemotePublisher::matches)
    }
}
