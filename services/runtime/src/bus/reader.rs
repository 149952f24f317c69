//! The reading ends: newest value, queue, callback. Delivery from the same process takes no lock
//! and no memory.

use std::any::Any;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;
use tangent_schemas::{Message, cdr};
use triple_buffer::{Input, TripleBuffer};

use super::attachment::Attachment;
use super::guard::{Guard, Verdict};
use super::sleeper::{Sleeper, sleep_for};
use super::source::{Admission, Rival};
use crate::clock;

/// A message and how it came.
#[derive(Clone, Debug)]
pub struct Received<M> {
    /// What was said.
    pub message: M,
    /// Counts its publisher's messages from 1; 0 when the publisher does not say.
    pub sequence: u64,
    /// When it was published, ns since the Unix epoch on the publisher's host.
    pub source_time_ns: i64,
    /// When it arrived here, on the clock that judges silence.
    pub received: Instant,
    /// Its publisher's id.
    pub publisher: [u8; 16],
}

impl<M> Received<M> {
    /// Time since it arrived here.
    pub fn age(&self) -> Duration {
        self.received.elapsed()
    }
}

/// What happened to a reader's messages since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Delivered to this reader.
    pub received: u64,
    /// Missing by sequence: lost between the processes.
    pub missing: u64,
    /// Pushed out of a full queue, or arrived while the callback was running in the same thread.
    pub dropped: u64,
    /// Refused: doubled or overtaken by a newer one.
    pub overtaken: u64,
    /// Refused: older than the reader accepts.
    pub too_old: u64,
    /// Refused: another type, or bytes that are no message.
    pub undecodable: u64,
    /// Refused: of another publisher, on a topic that has one.
    pub second_source: u64,
    /// Refused: on more keys than a reader of patterns follows.
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

/// Where messages go.
pub(crate) enum Sink<M: Message> {
    /// The newest value. The lock is between publishers of the same topic only: reader and writer
    /// never wait for one another, even when one of them is pre-empted in the middle.
    Newest(Mutex<Input<Option<Received<M>>>>),
    Queue {
        queue: Box<ArrayQueue<Received<M>>>,
        sleeper: Sleeper,
    },
    Callback {
        callback: Mutex<Callback<M>>,
        /// Thread that is in the callback, by number; 0: none.
        inside: AtomicU64,
    },
}

impl<M: Message> Sink<M> {
    pub(crate) fn queue(capacity: usize) -> Self {
        Self::Queue {
            queue: Box::new(ArrayQueue::new(capacity.max(1))),
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

/// A reader without its type: takes encoded samples from other processes.
pub(crate) trait ErasedReader: Send + Sync {
    fn message_name(&self) -> &'static str;
    /// Who is refused, on a topic that has one publisher, and how many samples were.
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
    /// From this process.
    pub near: bool,
}

/// The reader's end of a triple buffer: three values, of which writer and reader own one each and
/// swap for the third.
pub(crate) type Output<M> = triple_buffer::Output<Option<Received<M>>>;

pub(crate) struct ReaderCore<M: Message> {
    sink: Sink<M>,
    admission: Admission,
    guard: Mutex<Guard>,
    counts: AtomicCounts,
    /// Oldest source time accepted, as an age in ns; 0: any.
    age_max_ns: AtomicI64,
}

impl<M: Message> ReaderCore<M> {
    /// For a reader of the newest value, with that reader's end.
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

    /// From a publisher of this process, in its thread.
    pub(crate) fn deliver_near(&self, received: &Received<M>) {
        self.admission.near(received.received);
        self.deliver(received);
    }

    /// No other publisher is taken until this is released.
    pub(crate) fn hold(&self, held: bool) {
        self.admission.hold(held);
    }

    /// In the sender's thread, or in Zenoh's.
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
                if queue.force_push(received.clone()).is_some() {
                    add(&self.counts.dropped, 1);
                }
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
                        // Two publishers on one topic: the second waits for the first to be done.
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
        // Once is enough for a person; the count says the rest.
        if self.counts.undecodable.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!("{key}: a sample was refused: {why} (further ones are only counted)");
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
            // Were it two publishers, the greater count would silence the other for good.
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

/// A small number per thread, never 0; `ThreadId` has none on stable Rust.
fn thread_number() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    thread_local!(static NUMBER: u64 = NEXT.fetch_add(1, Ordering::Relaxed));
    NUMBER.with(|number| *number)
}

/// Keeps a callback, an answerer or a subscription in force; dropping it ends it. Do not drop one
/// inside its own callback.
#[must_use = "dropping the handle ends what it stands for"]
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

    /// Keeps something else for as long.
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

/// Every message of a topic, through a bounded queue.
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

    /// The oldest message that waits, if one does.
    pub fn try_recv(&self) -> Option<Received<M>> {
        match &self.core.sink {
            Sink::Queue { queue, .. } => queue.pop(),
            Sink::Newest(_) | Sink::Callback { .. } => None,
        }
    }

    /// The oldest message, waiting for it at most so long. For one thread at a time.
    pub fn recv_timeout(&self, timeout: Duration) -> Option<Received<M>> {
        let Sink::Queue { queue, sleeper } = &self.core.sink else {
            return None;
        };
        sleep_for(queue, sleeper, timeout)
    }

    /// Refuses samples from other processes whose source time is older than `age` when they arrive.
    /// Only where the hosts' clocks agree.
    pub fn refuse_older_than(&self, age: Duration) {
        self.core.refuse_older_than(age);
    }

    /// What happened to this reader's messages.
    pub fn counts(&self) -> Counts {
        self.core.counts()
    }

    /// Messages that were not read: never came, or pushed out of the full queue.
    pub fn lost(&self) -> u64 {
        let counts = self.counts();
        counts.missing + counts.dropped
    }
}
