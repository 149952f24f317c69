//! The two threads that empty the queues of outgoing messages, one for images and one for
//! everything else.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;

use tangent_schemas::topics::Delivery;

use super::history::History;
use super::outlet::AnyOutlet;
use super::recall::Recall;
use crate::realtime::setup_thread;

/// Messages of one lower class that are sent before the real-time queues are checked again.
const BURST: usize = 8;
/// Longest time that a message of a lower class waits after one before it. 7000 records per second
/// would wake this thread, and those of each program that they pass through, once each.
const LINGER: Duration = Duration::from_millis(1);

#[derive(Default)]
struct Shared {
    outlets: Mutex<Vec<Arc<dyn AnyOutlet>>>,
    generation: AtomicU64,
    stopping: AtomicBool,
    /// Whether the thread looks into all queues again within [`LINGER`], without being woken.
    lingers: AtomicBool,
    recall: Option<Arc<Recall>>,
}

impl Shared {
    /// Waits for the next message. After one of a lower class, further ones do not wake the thread,
    /// but are sent together at the end of [`LINGER`].
    fn wait(&self, lingers: bool) {
        if lingers {
            self.lingers.store(true, Ordering::Release);
            std::thread::park_timeout(LINGER);
            self.lingers.store(false, Ordering::Relaxed);
            // Whoever has seen `true` has queued its message before.
            fence(Ordering::SeqCst);
        } else {
            std::thread::park_timeout(Duration::from_secs(1));
        }
    }

    /// Whether a message with this delivery, which has just been queued, is sent only if the thread
    /// is woken.
    fn must_wake(&self, delivery: Delivery) -> bool {
        if delivery == Delivery::RealTime {
            return true;
        }
        // The message is in its queue before the thread is seen to linger.
        fence(Ordering::SeqCst);
        !self.lingers.load(Ordering::Relaxed)
    }
}

/// Wakes a publishing thread.
pub(crate) struct Waker {
    shared: Arc<Shared>,
    thread: Option<Thread>,
    delivery: Delivery,
}

impl Waker {
    /// Sees to it that a message that has just been queued is sent. No lock.
    pub(crate) fn queued(&self) {
        if self.shared.must_wake(self.delivery) {
            self.wake();
        }
    }

    /// Wakes the thread.
    pub(crate) fn wake(&self) {
        if let Some(thread) = &self.thread {
            thread.unpark();
        }
    }

    /// The thread, if it could be started.
    pub(crate) fn thread(&self) -> Option<Thread> {
        self.thread.clone()
    }
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
        self.lane(outlet.delivery()).add(outlet);
    }

    /// Wakes the thread that sends messages with this delivery.
    pub(crate) fn waker(&self, delivery: Delivery) -> Waker {
        self.lane(delivery).waker(delivery)
    }

    /// The count of messages that their queues had no room for.
    pub(crate) fn drops(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.dropped)
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

    fn waker(&self, delivery: Delivery) -> Waker {
        Waker {
            shared: Arc::clone(&self.shared),
            thread: self.thread.clone(),
            delivery,
        }
    }

    fn add(&self, outlet: Arc<dyn AnyOutlet>) {
        let mut outlets = lock(&self.shared.outlets);
        outlets.push(outlet);
        outlets.sort_by_key(|outlet| outlet.delivery());
        self.shared.generation.fetch_add(1, Ordering::Release);
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
    // Whether a message of a lower class was sent since the last wait.
    let mut lingers = false;
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
                    lingers = true;
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
        shared.wait(std::mem::take(&mut lingers));
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;
    use std::time::Instant;

    /// Messages without contents; counts how often the publishing thread found some.
    struct Counted {
        delivery: Delivery,
        waiting: AtomicUsize,
        sent: AtomicUsize,
        rounds: AtomicUsize,
    }

    impl Counted {
        fn on(lane: &Lane, delivery: Delivery) -> (Arc<Self>, Waker) {
            let outlet = Arc::new(Self {
                delivery,
                waiting: AtomicUsize::new(0),
                sent: AtomicUsize::new(0),
                rounds: AtomicUsize::new(0),
            });
            lane.add(Arc::clone(&outlet) as _);
            (outlet, lane.waker(delivery))
        }

        fn sent_within(&self, count: usize, patience: Duration) -> bool {
            let until = Instant::now() + patience;
            while self.sent.load(Ordering::SeqCst) < count {
                if Instant::now() > until {
                    return false;
                }
                std::thread::yield_now();
            }
            true
        }
    }

    impl AnyOutlet for Counted {
        fn delivery(&self) -> Delivery {
            self.delivery
        }

        fn publisher(&self) -> [u8; 16] {
            [0; 16]
        }

        fn send_one(&self, _: &mut Vec<u8>, _: &mut History) -> bool {
            let waiting = self.waiting.load(Ordering::SeqCst);
            if waiting == 0 {
                return false;
            }
            self.waiting.fetch_sub(1, Ordering::SeqCst);
            self.sent.fetch_add(1, Ordering::SeqCst);
            self.rounds
                .fetch_add(usize::from(waiting == 1), Ordering::SeqCst);
            true
        }

        fn is_done(&self) -> bool {
            false
        }
    }

    /// 700 messages within 100 ms, or longer on a slow machine: one round per millisecond, and a
    /// few more at the ends of bursts.
    #[test]
    fn many_messages_are_sent_together_and_none_is_left_behind() {
        let lane = Lane::start("test-publish", "test", None, None);
        let (outlet, waker) = Counted::on(&lane, Delivery::Stream);
        let began = Instant::now();
        for k in 0..700_u32 {
            while began.elapsed() < k * Duration::from_millis(1) / 7 {
                std::hint::spin_loop();
            }
            outlet.waiting.fetch_add(1, Ordering::SeqCst);
            waker.queued();
        }
        let took_ms = began.elapsed().as_millis() as usize;
        // Far less than the second after which the thread looks by itself.
        assert!(outlet.sent_within(700, Duration::from_millis(500)));
        let rounds = outlet.rounds.load(Ordering::SeqCst);
        assert!(rounds < 100 + 2 * took_ms, "{rounds} in {took_ms} ms");
        lane.stop();
    }

    #[test]
    fn a_message_in_real_time_wakes_the_thread_and_a_single_one_too() {
        let lane = Lane::start("test-publish", "test", None, None);
        let (stream, streams) = Counted::on(&lane, Delivery::Stream);
        let (urgent, urgents) = Counted::on(&lane, Delivery::RealTime);
        for k in 1..=200 {
            stream.waiting.fetch_add(1, Ordering::SeqCst);
            streams.queued();
            urgent.waiting.fetch_add(1, Ordering::SeqCst);
            assert!(lane.shared.must_wake(Delivery::RealTime));
            urgents.queued();
            for outlet in [&stream, &urgent] {
                assert!(outlet.sent_within(k, Duration::from_millis(500)), "{k}");
            }
            std::thread::sleep(Duration::from_micros(1500) * (k as u32 % 3));
        }
        lane.stop();
    }
}
