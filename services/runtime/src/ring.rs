//! Bounded queue between threads of different priorities, in which no thread waits for another.
//!
//! Used wherever a real-time thread meets one of lower priority: publishers, subscriptions,
//! mailboxes, the log. In the queues of `crossbeam`, `pop` spins while a `push` is unfinished. On
//! one core a thread with SCHED_FIFO that has interrupted that push itself then spins until Linux
//! takes the core away from it, up to a second later. Here, such an item is not there yet. Whoever
//! pushes must therefore wake the reader *after* the push.
//!
//! Ring of slots with sequence numbers (D. Vyukov, "Bounded MPMC queue", 2010). An operation is
//! repeated only if another one succeeded meanwhile, so it is lock-free.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, TryLockError};

/// Bounded queue for any number of senders and receivers. Allocates only when it is made.
#[derive(Debug)]
pub struct Ring<T> {
    /// One more than the capacity, so that a pop that stands unfinished leaves room for the newest
    /// item.
    slots: Box<[Slot<T>]>,
    /// Number of pushes begun, which is the place of the next one.
    pushed: AtomicUsize,
    /// Number of pops begun.
    popped: AtomicUsize,
}

#[derive(Debug)]
struct Slot<T> {
    /// Twice the number of items that have passed through the slot, plus one while it holds one.
    stamp: AtomicUsize,
    /// Whoever has claimed the slot by its stamp is alone with it, so this lock is always free.
    item: Mutex<Option<T>>,
}

impl<T> Slot<T> {
    fn swap(&self, item: Option<T>) -> Option<T> {
        let mut place = match self.item.try_lock() {
            Ok(place) => place,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return item,
        };
        std::mem::replace(&mut *place, item)
    }
}

impl<T> Ring<T> {
    /// An empty queue for `capacity` items, at least one.
    pub fn new(capacity: usize) -> Self {
        let slot = |_| Slot {
            stamp: AtomicUsize::new(0),
            item: Mutex::new(None),
        };
        Self {
            slots: (0..=capacity.max(1)).map(slot).collect(),
            pushed: AtomicUsize::new(0),
            popped: AtomicUsize::new(0),
        }
    }

    /// The slot at this place, and its stamp while it is free for that place.
    fn slot(&self, place: usize) -> (&Slot<T>, usize) {
        let count = self.slots.len();
        (&self.slots[place % count], 2 * (place / count))
    }

    /// Claims the next place of those `begun`, if its slot is free (`held` 0) or holds an item
    /// (`held` 1); returns the slot, and its stamp while it was free.
    fn claim(&self, begun: &AtomicUsize, held: usize) -> Option<(&Slot<T>, usize)> {
        let mut place = begun.load(Ordering::Relaxed);
        loop {
            let (slot, free) = self.slot(place);
            if slot.stamp.load(Ordering::Acquire) == free + held {
                let (old, new) = (place, place + 1);
                match begun.compare_exchange_weak(old, new, Ordering::SeqCst, Ordering::Relaxed) {
                    Ok(_) => return Some((slot, free)),
                    Err(now) => place = now,
                }
            } else {
                let now = begun.load(Ordering::SeqCst);
                if now == place {
                    return None;
                }
                place = now;
            }
        }
    }

    /// Appends an item. Never waits, allocates nothing.
    ///
    /// # Errors
    /// The queue is full, or the pop of its oldest item is unfinished: returns the item.
    pub fn push(&self, item: T) -> Result<(), T> {
        if self.is_full() {
            return Err(item);
        }
        let Some((slot, free)) = self.claim(&self.pushed, 0) else {
            return Err(item);
        };
        slot.swap(Some(item));
        slot.stamp.store(free + 1, Ordering::Release);
        Ok(())
    }

    /// Appends an item. If the queue is full, its oldest item gives way: it is passed to `dropped`.
    /// So is the new one, if another thread stands in the middle of a push or pop that it would
    /// have to wait for; what is queued stays. Never waits, allocates nothing.
    pub fn force_push(&self, mut item: T, mut dropped: impl FnMut(T)) {
        while let Err(refused) = self.push(item) {
            item = refused;
            let oldest = if self.is_full() { self.pop() } else { None };
            match oldest {
                Some(oldest) => dropped(oldest),
                None => return dropped(item),
            }
        }
    }

    /// Takes the oldest item; `None` if there is none, or if its push is unfinished. Never waits,
    /// allocates nothing.
    pub fn pop(&self) -> Option<T> {
        let (slot, free) = self.claim(&self.popped, 1)?;
        let item = slot.swap(None);
        slot.stamp.store(free + 2, Ordering::Release);
        item
    }

    /// Number of items, with those whose push is unfinished.
    pub fn len(&self) -> usize {
        let popped = self.popped.load(Ordering::SeqCst);
        self.pushed.load(Ordering::SeqCst).saturating_sub(popped)
    }

    /// Whether no further item fits.
    pub fn is_full(&self) -> bool {
        self.len() >= self.slots.len() - 1
    }

    /// Whether every item was taken whose push has begun.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    use std::time::{Duration, Instant};

    use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
    use nix::unistd::Pid;

    use super::*;
    use crate::realtime::in_scheduled_thread;

    #[test]
    fn it_is_a_queue_that_forgets_its_oldest_items() {
        for capacity in [1, 2, 3, 5, 8] {
            let (ring, mut expected) = (Ring::new(capacity), VecDeque::new());
            for i in 0..200_u32 {
                match i % 7 {
                    0 | 3 | 4 => {
                        let pushed = ring.push(i);
                        assert_eq!(pushed.is_ok(), expected.len() < capacity);
                        if pushed.is_ok() {
                            expected.push_back(i);
                        }
                    }
                    1 | 5 => {
                        let mut dropped = Vec::new();
                        ring.force_push(i, |oldest| dropped.push(oldest));
                        expected.push_back(i);
                        let more = expected.len().saturating_sub(capacity);
                        assert_eq!(dropped, expected.drain(..more).collect::<Vec<_>>());
                    }
                    _ => assert_eq!(ring.pop(), expected.pop_front()),
                }
                assert_eq!(ring.is_empty(), expected.is_empty());
            }
        }
    }

    #[test]
    fn nobody_waits_for_an_unfinished_push_or_pop() {
        let ring = Ring::new(2);
        // Another thread has begun to push, and stands.
        ring.pushed.fetch_add(1, Ordering::SeqCst);
        assert_eq!(ring.pop(), None);
        assert!(!ring.is_empty());
        assert_eq!(ring.push(2), Ok(()));
        assert_eq!(ring.pop(), None);
        assert_eq!(ring.push(3), Err(3));
        let mut dropped = Vec::new();
        ring.force_push(4, |item| dropped.push(item));
        assert_eq!(dropped, [4]);
        // It goes on.
        ring.slots[0].swap(Some(1));
        ring.slots[0].stamp.store(1, Ordering::Release);
        assert_eq!(
            [ring.pop(), ring.pop(), ring.pop()],
            [Some(1), Some(2), None]
        );

        // Another thread has begun to pop, and stands.
        assert_eq!([ring.push(5), ring.push(6)], [Ok(()), Ok(())]);
        ring.popped.fetch_add(1, Ordering::SeqCst);
        assert_eq!([ring.push(7), ring.push(8)], [Ok(()), Err(8)]);
        dropped.clear();
        ring.force_push(8, |item| dropped.push(item));
        ring.force_push(9, |item| dropped.push(item));
        assert_eq!(dropped, [6, 8, 9]);
        assert_eq!([ring.pop(), ring.pop()], [Some(7), None]);
    }

    #[test]
    fn every_item_of_every_sender_arrives_once_and_in_its_order() {
        const SENDERS: u64 = 3;
        const ITEMS: u64 = 20_000;
        let ring = Arc::new(Ring::new(7));
        let senders = (0..SENDERS).map(|sender| {
            let ring = Arc::clone(&ring);
            std::thread::spawn(move || {
                for i in 0..ITEMS {
                    let mut item = sender * ITEMS + i;
                    while let Err(refused) = ring.push(item) {
                        item = refused;
                        std::thread::yield_now();
                    }
                }
            })
        });
        let senders: Vec<_> = senders.collect();
        let mut next: Vec<u64> = (0..SENDERS).map(|sender| sender * ITEMS).collect();
        for _ in 0..SENDERS * ITEMS {
            let item = loop {
                match ring.pop() {
                    Some(item) => break item,
                    None => std::thread::yield_now(),
                }
            };
            let expected = &mut next[(item / ITEMS) as usize];
            assert_eq!(item, *expected);
            *expected += 1;
        }
        senders
            .into_iter()
            .for_each(|sender| sender.join().unwrap());
        assert!(ring.is_empty() && ring.pop().is_none());
    }

    /// Sender and receiver share a core. The receiver wakes up in the middle of a push again and
    /// again; if it waited for that push, it would do so until Linux takes the core away from it.
    #[test]
    fn a_real_time_reader_goes_on_where_it_has_interrupted_a_push() {
        tangent_live::live(|| {
            let cpus = sched_getaffinity(Pid::from_raw(0)).unwrap();
            let cpu = (0..CpuSet::count())
                .find(|&cpu| cpus.is_set(cpu).unwrap())
                .unwrap();
            let mut one = CpuSet::new();
            one.set(cpu).unwrap();
            let keep = move || sched_setaffinity(Pid::from_raw(0), &one).unwrap();

            let (ring, ends) = (Arc::new(Ring::new(64)), Arc::new(AtomicBool::new(false)));
            let sender = std::thread::spawn({
                let (ring, ends) = (Arc::clone(&ring), Arc::clone(&ends));
                move || {
                    keep();
                    while !ends.load(Ordering::Relaxed) {
                        ring.force_push([0_u8; 512], drop);
                    }
                }
            });
            let longest = in_scheduled_thread(10, |granted| {
                if let Err(why) = granted {
                    eprintln!("skipped, because SCHED_FIFO is not granted: {why}");
                    return Duration::ZERO;
                }
                keep();
                let pop = |_| {
                    std::thread::sleep(Duration::from_micros(200));
                    let began = Instant::now();
                    while ring.pop().is_some() {}
                    began.elapsed()
                };
                (0..5000).map(pop).max().unwrap()
            });
            ends.store(true, Ordering::Relaxed);
            sender.join().unwrap();
            let longest = longest.unwrap();
            assert!(longest < Duration::from_millis(100), "{longest:?}");
        });
    }
}
