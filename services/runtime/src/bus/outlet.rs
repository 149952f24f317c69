//! The way out of the process: each publisher's queue, and the two threads that empty them: one for images, one for everything else.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;

use crossbeam_queue::ArrayQueue;
use tangent_schemas::topics::Delivery;
use tangent_schemas::{Message, cdr};
use zenoh::key_expr::OwnedKeyExpr;

use super::attachment::Attachment;
use super::raw::{self, RawMessage};
use super::reader::Received;
use super::registry::Registry;
use super::session::RemotePublisher;
use crate::realtime::setup_thread;

/// Messages of one lower class that are sent before the real-time queues are looked at again.
const BURST: usize = 8;

/// How many messages wait for the publishing thread before the oldest goes.
fn capacity<M>(delivery: Delivery) -> usize {
    match delivery {
        // What fits into two mebibytes: more than a second of raw records at 7 kHz. A recorder wants every one.
        Delivery::RealTime | Delivery::Stream => {
            ((2 << 20) / size_of::<Received<M>>()).clamp(256, 1 << 14)
        }
        Delivery::Background => 64,
        // A newer image is worth more than an older one.
        Delivery::Bulk => 4,
    }
}

/// One publisher's way out.
pub(crate) struct Outlet<M> {
    key: OwnedKeyExpr,
    delivery: Delivery,
    queue: ArrayQueue<Received<M>>,
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
    ) -> Self {
        Self {
            key,
            delivery,
            queue: ArrayQueue::new(capacity::<M>(delivery)),
            remote,
            registry,
            dropped: Arc::clone(&pump.dropped),
            closed: AtomicBool::new(false),
        }
    }

    /// Somebody outside, or a recorder inside, wants this topic. No lock.
    pub(crate) fn is_wanted(&self) -> bool {
        self.is_wanted_remotely() || self.registry.has_raw_readers()
    }

    pub(crate) fn is_wanted_remotely(&self) -> bool {
        self.remote.as_ref().is_some_and(RemotePublisher::matches)
    }

    /// Leaves a message for the publishing thread. No lock, no memory.
    pub(crate) fn push(&self, received: Received<M>) {
        if self.queue.force_push(received).is_some() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
    }
}

/// An outlet without its type.
pub(crate) trait AnyOutlet: Send + Sync {
    fn delivery(&self) -> Delivery;
    /// Sends the oldest waiting message; false when none waits.
    fn send_one(&self, scratch: &mut Vec<u8>) -> bool;
    /// Its publisher is gone and everything is sent.
    fn is_done(&self) -> bool;
}

impl<M: Message> AnyOutlet for Outlet<M> {
    fn delivery(&self) -> Delivery {
        self.delivery
    }

    fn send_one(&self, scratch: &mut Vec<u8>) -> bool {
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
}

/// The publishing threads. Images have their own: Zenoh lets the pieces of one wait for the wire, and nothing else may wait for them.
pub(crate) struct Pump {
    dropped: Arc<AtomicU64>,
    messages: Lane,
    images: Lane,
}

impl Pump {
    /// `priority`: of SCHED_FIFO for the publishing threads, that of images one lower; `None` for normal scheduling.
    pub(crate) fn start(priority: Option<u8>) -> Self {
        let behind = priority.map(|priority| priority.saturating_sub(1).max(1));
        Self {
            dropped: Arc::default(),
            messages: Lane::start("bus-publish", "bus publishing", priority),
            images: Lane::start("bus-images", "bus publishing images", behind),
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

    /// The thread that sends what goes out so.
    pub(crate) fn thread(&self, delivery: Delivery) -> Option<Thread> {
        self.lane(delivery).thread.clone()
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Sends what waits and ends the threads.
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
    /// `role` names the thread in what is said of its scheduling.
    fn start(name: &str, role: &'static str, priority: Option<u8>) -> Self {
        let shared = Arc::new(Shared::default());
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
                tracing::error!("no thread {name} ({error}): nothing of its leaves this process");
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

fn pump(shared: &Shared) {
    let mut scratch = Vec::with_capacity(4096);
    let mut generation = u64::MAX;
    let mut outlets: Vec<Arc<dyn AnyOutlet>> = Vec::new();
    loop {
        let stopping = shared.stopping.load(Ordering::Acquire);
        let now = shared.generation.load(Ordering::Acquire);
        if now != generation {
            outlets.clone_from(&lock(&shared.outlets));
            generation = now;
        }
        let mut worked = false;
        for outlet in &outlets {
            for _ in 0..BURST {
                if !outlet.send_one(&mut scratch) {
                    break;
                }
                worked = true;
                if outlet.delivery() != Delivery::RealTime {
                    drain_real_time(&outlets, &mut scratch);
                }
            }
        }
        if worked {
            continue;
        }
        if outlets.iter().any(|outlet| outlet.is_done()) {
            // Their Zenoh publishers are undeclared here, not in the thread that dropped the publisher.
            outlets.clear();
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

fn drain_real_time(outlets: &[Arc<dyn AnyOutlet>], scratch: &mut Vec<u8>) {
    for outlet in outlets {
        if outlet.delivery() != Delivery::RealTime {
            return;
        }
        while outlet.send_one(scratch) {}
    }
}
