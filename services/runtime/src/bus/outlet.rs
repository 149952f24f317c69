//! Outgoing messages: a queue per publisher, and the two threads that empty the queues, one for
//! images and one for everything else.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;

use tangent_schemas::topics::Delivery;
use tangent_schemas::{Message, cdr};
use zenoh::key_expr::OwnedKeyExpr;

use super::attachment::Attachment;
use super::history::History;
use super::raw::{self, RawMessage};
use super::reader::Received;
use super::recall::Recall;
use super::registry::Registry;
use super::remote_publisher::RemotePublisher;
use crate::realtime::setup_thread;
use crate::ring::Ring;

/// Messages of one lower class that are sent before the real-time queues are checked again.
const BURST: usize = 8;

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
    pub(crate) fn new(
        key: OwnedKeyExpr,
        delivery: Delivery,
        remote: Option<RemotePublisher>,
        registry: Arc<Registry>,
        pump: &Pump,
        publisher: [u8; 16],
    ) -> Self {
        Self {
            key,
            delivery,
            publisher,
            queue: Ring::new(capacity::<M>(delivery)),
            remote,
            registry,
            dropped: Arc::clone(&pump.dropped),
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

#[derive(Default)]
struct Shared {
    outlets: Mutex<Vec<Arc<dyn AnyOutlet>>>,
    generation: AtomicU64,
    stopping: AtomicBool,
    recall: Option<Arc<Recall>>,
}

/// The publishing threads. Images have their own: Zenoh makes the fragments of one wait for the
/// link, and no other message may wait for them.
pub(crate) struct Pump {
    dropped: Arc<AtomicU64>,
    messages: Lane,
    images: Lane,
}

impl Pump {
    /// `priority` is the SCHED_FIFO priority of the publishing threads; that of images gets one
    /// less. `None`: normal scheduling.
    pub(crate) fn start(priority: Option<u8>, recall: Option<Arc<Recall>>) -> Self {
        let behind = priority.map(|priority| priority.saturating_sub(1).max(1));
        Self {
            dropped: Arc::default(),
            messages: Lane::start("bus-publish", "bus publishing", priority, recall),
            images: Lane::start("bus-images", "bus publishing images", behind, None),
        }
    }

    fn lane(&self, delivery: Delivery) -> &Lane {
        match delivery {
            Delivery::Bulk => &self.images,
            Delivery::RealTime | Delivery::Stream | Delivery::Background => &self.messages,
        }
    }

    pub(crate) fn add(&self, outlet: Arc<dyn AnyOutlet>) {
        let shared = &self.lane(outlet.delivery()).shared;
        let mut outlets = lock(&shared.outlets);
        outlets.push(outlet);
        outlets.sort_by_key(|outlet| outlet.delivery());
        shared.generation.fetch_add(1, Ordering::Release);
    }

    /// The thread that sends messages with this delivery.
    pub(crate) fn thread(&self, delivery: Delivery) -> Option<Thread> {
        self.lane(delivery).thread.clone()
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Sends everything that is queued, and ends the threads.
    pub(crate) fn stop(&self) {
        for lane in [&self.messages, &self.images] {
            lane.stop();
        }
    }
}

/// One publishing thread.
struct Lane {
    shared: Arc<Shared>,
    thread: Option<Thread>,
    join: Mutex<Option<JoinHandle<()>>>,
}

impl Lane {
    /// `role` names the thread in the report on its scheduling.
    fn start(
        name: &str,
        role: &'static str,
        priority: Option<u8>,
        recall: Option<Arc<Recall>>,
    ) -> Self {
        let shared = Arc::new(Shared {
            recall,
            ..Shared::default()
        });
        let pumped = Arc::clone(&shared);
        let spawned = std::thread::Builder::new()
            .name(name.into())
            .spawn(move || {
                if let Some(priority) = priority {
                    setup_thread(role, priority);
                }
                pump(&pumped);
            });
        match spawned {
            Ok(join) => Self {
                shared,
                thread: Some(join.thread().clone()),
                join: Mutex::new(Some(join)),
            },
            Err(error) => {
                tracing::error!(
                    "thread {name} could not be started ({error}): its messages do not leave this process"
                );
                Self {
                    shared,
                    thread: None,
                    join: Mutex::new(None),
                }
            }
        }
    }

    fn stop(&self) {
        self.shared.stopping.store(true, Ordering::Release);
        if let Some(thread) = &self.thread {
            thread.unpark();
        }
        let join = lock(&self.join).take();
        if let Some(join) = join
            && join.thread().id() != std::thread::current().id()
            && join.join().is_err()
        {
            tracing::error!("a publishing thread panicked");
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An outlet and the history of its sent messages.
struct Line {
    outlet: Arc<dyn AnyOutlet>,
    history: History,
}

impl Line {
    fn send_one(&mut self, scratch: &mut Vec<u8>) -> bool {
        self.outlet.send_one(scratch, &mut self.history)
    }
}

/// Updates the lines to these outlets; the history of outlets that stay is kept.
fn follow(lines: &mut Vec<Line>, outlets: &[Arc<dyn AnyOutlet>]) {
    let mut before = std::mem::take(lines);
    for outlet in outlets {
        let known = before
            .iter()
            .position(|line| Arc::ptr_eq(&line.outlet, outlet));
        lines.push(match known {
            Some(at) => before.swap_remove(at),
            None => Line {
                outlet: Arc::clone(outlet),
                history: History::default(),
            },
        });
    }
}

fn pump(shared: &Shared) {
    let mut scratch = Vec::with_capacity(4096);
    let mut generation = u64::MAX;
    let mut lines: Vec<Line> = Vec::new();
    loop {
        let stopping = shared.stopping.load(Ordering::Acquire);
        let now = shared.generation.load(Ordering::Acquire);
        if now != generation {
            follow(&mut lines, &lock(&shared.outlets));
            generation = now;
        }
        let mut worked = false;
        for at in 0..lines.len() {
            for _ in 0..BURST {
                if !lines[at].send_one(&mut scratch) {
                    break;
                }
                worked = true;
                if lines[at].outlet.delivery() != Delivery::RealTime {
                    drain_real_time(&mut lines, &mut scratch);
                }
            }
        }
        if let Some(recall) = &shared.recall
            && let Some(ask) = recall.next()
        {
            let asked = |line: &&Line| line.outlet.publisher() == ask.publisher;
            let kept = lines.iter().find(asked).map(|line| line.history.blocks());
            recall.answer(ask, kept.unwrap_or_default());
            worked = true;
        }
        if worked {
            continue;
        }
        if lines.iter().any(|line| line.outlet.is_done()) {
            // The Zenoh publishers are undeclared here, not in the thread that dropped the
            // publisher.
            lines.retain(|line| !line.outlet.is_done());
            lock(&shared.outlets).retain(|outlet| !outlet.is_done());
            shared.generation.fetch_add(1, Ordering::Release);
            continue;
        }
        if stopping {
            lock(&shared.outlets).clear();
            return;
        }
        std::thread::park_timeout(Duration::from_secs(1));
    }
}

fn drain_real_time(lines: &mut [Line], scratch: &mut Vec<u8>) {
    for line in lines {
        if line.outlet.delivery() != Delivery::RealTime {
            return;
        }
        while line.send_one(scratch) {}
    }
}
