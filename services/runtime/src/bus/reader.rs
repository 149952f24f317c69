//! Readers: newest value, queue, callback. Delivery within the same process takes no lock and
//! allocates nothing.

use std::any::Any;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use tangent_schemas::{Message, cdr};
use triple_buffer::{Input, TripleBuffer};

use super::attachment::Attachment;
use super::guard::{Guard, Verdict};
use super::sleeper::{Sleeper, sleep_for};
use super::source::{Admission, Rival};
use crate::clock;
use crate::ring::Ring;

/// A message and the circumstances of its arrival.
#[derive(Clone, Debug)]
pub struct Received<M> {
    /// The message itself.
    pub message: M,
    /// Sequence number, counted by its publisher from 1; 0 if the publisher does not state it.
    pub sequence: u64,
    /// Time of publication, ns since the Unix epoch on the publisher's host.
    pub source_time_ns: i64,
    /// Time of arrival here, on the clock that is used to detect silence.
    pub received: Instant,
    /// Id of its publisher.
    pub publisher: [u8; 16],
}

impl<M> Received<M> {
    /// Time since its arrival here.
    pub fn age(&self) -> Duration {
        self.received.elapsed()
    }
}

/// Counts of a reader's messages since the reader was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Delivered to this reader.
    pub received: u64,
    /// Missing by sequence number: lost between the processes.
    pub missing: u64,
    /// Dropped from a full queue, or arrived while the callback was running in the same thread.
    pub dropped: u64,
    /// Refused: duplicates, or overtaken by a newer one.
    pub overtaken: u64,
    /// Refused: older than the reader accepts.
    pub too_old: u64,
    /// Refused: of another type, or not decodable.
    pub undecodable: u64,
    /// Refused: from a second publisher, on a topic that has one.
    pub second_source: u64,
    /// Refused: on keys beyond the limit that a reader of patterns follows.
    pub new_keys: u64,
}

#[derive(Debug, Default)]
struct AtomicCounts {
    received: AtomicU64,
    missing: AtomicU64,
    dropped: AtomicU64,
    overtaken: AtomicU64,
    too_old: AtomicU64,
    undecodable: AtomicU64,
}

fn add(count: &AtomicU64, more: u64) {
    count.fetch_add(more, Ordering::Relaxed);
}

type Callback<M> = Box<dyn FnMut(&Received<M>) + Send>;

/// Destination of the messages.
pub(crate) enum Sink<M: Message> {
    /// The newest value. The lock is only between publishers of the same topic: reader and writer
    /// never wait for each other, even if one is pre-empted halfway.
    Newest(Mutex<Input<Option<Received<M>>>>),
    Queue {
        queue: Ring<Received<M>>,
        sleeper: Sleeper,
    },
    Callback {
        callback: Mutex<Callback<M>>,
        /// Number of the thread that runs the callback; 0: none.
        inside: AtomicU64,
    },
}

impl<M: Message> Sink<M> {
    pub(crate) fn queue(capacity: usize) -> Self {
        Self::Queue {
            queue: Ring::new(capacity),
            sleeper: Sleeper::default(),
        }
    }

    pub(crate) fn callback(callback: impl FnMut(&Received<M>) + Send + 'static) -> Self {
        Self::Callback {
            callback: Mutex::new(Box::new(callback)),
            inside: AtomicU64::new(0),
        }
    }
}

/// A reader without its message type: takes encoded samples from other processes.
pub(crate) trait ErasedReader: Send + Sync {
    fn message_name(&self) -> &'static str;
    /// On a topic that has one publisher: the publisher refused now, and the number of samples
    /// refused.
    fn rival(&self, now: Instant) -> (Option<Rival>, u64);
    fn deliver_encoded(&self, key: &str, type_name: Option<&str>, at: Arrival<'_>);
}

/// An encoded sample.
#[derive(Clone, Copy)]
pub(crate) struct Arrival<'a> {
    pub payload: &'a [u8],
    pub attachment: Attachment,
    pub received: Instant,
    pub received_ns: i64,
    /// Whether it comes from this process.
    pub near: bool,
}

/// The reader's end of a triple buffer: of three values, writer and reader own one each, and swap
/// it for the third.
pub(crate) type Output<M> = triple_buffer::Output<Option<Received<M>>>;

pub(crate) struct ReaderCore<M: Message> {
    sink: Sink<M>,
    admission: Admission,
    guard: Mutex<Guard>,
    counts: AtomicCounts,
    /// Largest age by source time that is accepted, ns; 0: any.
    age_max_ns: AtomicI64,
}

impl<M: Message> ReaderCore<M> {
    /// For a reader of the newest value; also returns that reader's end of the buffer.
    pub(crate) fn newest(admission: Admission) -> (Self, Output<M>) {
        let (input, output) = TripleBuffer::default().split();
        (
            Self::new(Sink::Newest(Mutex::new(input)), admission),
            output,
        )
    }

    pub(crate) fn new(sink: Sink<M>, admission: Admission) -> Self {
        Self {
            sink,
            admission,
            guard: Mutex::default(),
            counts: AtomicCounts::default(),
            age_max_ns: AtomicI64::new(0),
        }
    }

    pub(crate) fn is_callback(&self) -> bool {
        matches!(self.sink, Sink::Callback { .. })
    }

    /// Delivers a message of a publisher in this process, in its thread.
    pub(crate) fn deliver_near(&self, received: &Received<M>) {
        self.admission.near(received.received);
        self.deliver(received);
    }

    /// While held, no other publisher is accepted.
    pub(crate) fn hold(&self, held: bool) {
        self.admission.hold(held);
    }

    /// Runs in the sender's thread, or in Zenoh's.
    fn deliver(&self, received: &Received<M>) {
        match &self.sink {
            Sink::Newest(input) => {
                add(&self.counts.received, 1);
                let mut input = input.lock().unwrap_or_else(PoisonError::into_inner);
                *input.input_buffer_mut() = Some(received.clone());
                input.publish();
            }
            Sink::Queue { queue, sleeper } => {
                add(&self.counts.received, 1);
                queue.force_push(received.clone(), |_| add(&self.counts.dropped, 1));
                sleeper.wake();
            }
            Sink::Callback { callback, inside } => {
                let me = thread_number();
                let mut guard = match callback.try_lock() {
                    Ok(guard) => guard,
                    Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
                    Err(TryLockError::WouldBlock) => {
                        if inside.load(Ordering::Acquire) == me {
                            add(&self.counts.dropped, 1);
                            return;
                        }
                        // If two publishers share a topic, the second one waits for the first.
                        callback.lock().unwrap_or_else(PoisonError::into_inner)
                    }
                };
                inside.store(me, Ordering::Release);
                add(&self.counts.received, 1);
                (*guard)(received);
                inside.store(0, Ordering::Release);
            }
        }
    }

    fn age_max(&self) -> Option<Duration> {
        match self.age_max_ns.load(Ordering::Relaxed) {
            0 => None,
            ns => Some(Duration::from_nanos(ns.unsigned_abs())),
        }
    }

    pub(crate) fn refuse_older_than(&self, age: Duration) {
        let ns = i64::try_from(age.as_nanos()).unwrap_or(i64::MAX).max(1);
        self.age_max_ns.store(ns, Ordering::Relaxed);
    }

    pub(crate) fn counts(&self) -> Counts {
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Counts {
            received: load(&self.counts.received),
            missing: load(&self.counts.missing),
            dropped: load(&self.counts.dropped),
            overtaken: load(&self.counts.overtaken),
            too_old: load(&self.counts.too_old),
            undecodable: load(&self.counts.undecodable),
            second_source: self.admission.refused(),
            new_keys: 0,
        }
    }

    fn undecodable(&self, key: &str, why: &dyn std::fmt::Display) {
        // One log line is enough; the counter shows the rest.
        if self.counts.undecodable.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!(
                "{key}: a sample was refused: {why} (further refusals are only counted)"
            );
        }
    }
}

impl<M: Message> ErasedReader for ReaderCore<M> {
    fn message_name(&self) -> &'static str {
        M::NAME
    }

    fn rival(&self, now: Instant) -> (Option<Rival>, u64) {
        (self.admission.rival(now), self.admission.refused())
    }

    fn deliver_encoded(&self, key: &str, type_name: Option<&str>, at: Arrival<'_>) {
        if let Some(other) = type_name.filter(|name| *name != M::NAME) {
            return self.undecodable(key, &format_args!("it is {other}, not {}", M::NAME));
        }
        let publisher = at.attachment.publisher;
        if !at.near && !self.admission.admit(publisher, at.received) {
            return;
        }
        let message = match cdr::decode::<M>(at.payload) {
            Ok(message) => message,
            Err(error) => return self.undecodable(key, &error),
        };
        let mut guard = self.guard.lock().unwrap_or_else(PoisonError::into_inner);
        let verdict = guard.judge(&at.attachment, at.received_ns, self.age_max());
        if verdict == Verdict::Overtaken && !at.near && self.admission.one_at_a_time() {
            // If there are two publishers, the greater sequence number would block the other for
            // ever.
            guard.forget(publisher);
            self.admission.overtaken(publisher, at.received);
        }
        drop(guard);
        match verdict {
            Verdict::Accept { missing } => {
                add(&self.counts.missing, missing);
                if !at.near && self.admission.is_contested(publisher, at.received) {
                    return;
                }
                self.deliver(&Received {
                    message,
                    sequence: at.attachment.sequence,
                    source_time_ns: at.attachment.source_time_ns,
                    received: at.received,
                    publisher,
                });
            }
            Verdict::Overtaken => add(&self.counts.overtaken, 1),
            Verdict::TooOld => add(&self.counts.too_old, 1),
        }
    }
}

impl Arrival<'_> {
    pub(crate) fn now(payload: &[u8], attachment: Attachment) -> Arrival<'_> {
        Arrival {
            payload,
            attachment,
            received: Instant::now(),
            received_ns: clock::now_ns(),
            near: false,
        }
    }
}

/// A small number per thread, never 0; stable Rust gives no number for a `ThreadId`.
fn thread_number() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    thread_local!(static NUMBER: u64 = NEXT.fetch_add(1, Ordering::Relaxed));
    NUMBER.with(|number| *number)
}

/// Keeps a callback, an answer handler or a subscription alive; dropping it ends that. Do not drop
/// one inside its own callback.
#[must_use = "dropping the handle ends its subscription or query"]
pub struct Handle {
    release: Option<Box<dyn FnOnce() + Send + Sync>>,
    kept: Vec<Box<dyn Any + Send + Sync>>,
}

impl Handle {
    pub(crate) fn new(release: impl FnOnce() + Send + Sync + 'static) -> Self {
        Self {
            release: Some(Box::new(release)),
            kept: Vec::new(),
        }
    }

    /// Keeps another value alive as long as this handle.
    pub(crate) fn keep(&mut self, what: impl Any + Send + Sync) {
        self.kept.push(Box::new(what));
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        if let Some(release) = self.release.take() {
            release();
        }
    }
}

/// Reads every message of a topic, through a bounded queue.
pub struct Subscription<M: Message> {
    core: Arc<ReaderCore<M>>,
    _handle: Handle,
}

impl<M: Message> Subscription<M> {
    pub(crate) fn new(core: Arc<ReaderCore<M>>, handle: Handle) -> Self {
        Self {
            core,
            _handle: handle,
        }
    }

    /// The oldest waiting message, if there is one.
    pub fn try_recv(&self) -> Option<Received<M>> {
        match &self.core.sink {
            Sink::Queue { queue, .. } => queue.pop(),
            Sink::Newest(_) | Sink::Callback { .. } => None,
        }
    }

    /// The oldest message, waiting for it for at most `timeout`. For one thread at a time.
    pub fn recv_timeout(&self, timeout: Duration) -> Option<Received<M>> {
        let Sink::Queue { queue, sleeper } = &self.core.sink else {
            return None;
        };
        sleep_for(queue, sleeper, timeout)
    }

    /// Refuses samples from other processes whose source time is older than `age` when they arrive.
    /// Use it only if the hosts' clocks agree.
    pub fn refuse_older_than(&self, age: Duration) {
        self.core.refuse_older_than(age);
    }

    /// Counts of this reader's messages, delivered and refused.
    pub fn counts(&self) -> Counts {
        self.core.counts()
    }

    /// Number of messages that were not read: they never arrived, or were dropped from the full
    /// queue.
    pub fn lost(&self) -> u64 {
        let counts = self.counts();
        counts.missing + counts.dropped
    }
}
