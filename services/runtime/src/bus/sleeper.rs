//! Lets a thread sleep until its queue has an item; the sender wakes it without waiting.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

use crate::ring::Ring;

/// Holds the handle of a queue's reading thread while that sleeps. One reader at a time.
#[derive(Debug, Default)]
pub(crate) struct Sleeper {
    asleep: AtomicBool,
    thread: Mutex<Option<Thread>>,
}

impl Sleeper {
    /// Wakes the reader if it sleeps. Call it after the push. Never waits: a reader that is just
    /// registering or deregistering itself checks its queue once more before it sleeps.
    pub(crate) fn wake(&self) {
        if self.asleep.swap(false, Ordering::SeqCst)
            && let Ok(thread) = self.thread.try_lock()
            && let Some(thread) = &*thread
        {
            thread.unpark();
        }
    }

    fn register(&self) {
        *self.thread.lock().unwrap_or_else(PoisonError::into_inner) = Some(std::thread::current());
        self.asleep.store(true, Ordering::SeqCst);
    }

    fn deregister(&self) {
        self.asleep.store(false, Ordering::SeqCst);
    }
}

/// Pops an item, or parks until a sender wakes this thread or the time is up.
pub(crate) fn sleep_for<T>(queue: &Ring<T>, sleeper: &Sleeper, timeout: Duration) -> Option<T> {
    let deadline = Instant::now() + timeout;
    loop {
        if let Some(item) = queue.pop() {
            return Some(item);
        }
        sleeper.register();
        // An item may have arrived after the first check and before registration; its sender did
        // not wake this thread.
        if let Some(item) = queue.pop() {
            sleeper.deregister();
            return Some(item);
        }
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            sleeper.deregister();
            return None;
        }
        std::thread::park_timeout(left);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn no_wake_is_missed_however_the_two_meet() {
        let queue = Arc::new(Ring::new(4));
        let sleeper = Arc::new(Sleeper::default());
        let (pushes, wakes) = (Arc::clone(&queue), Arc::clone(&sleeper));
        // Each item is pushed the moment the previous one was taken, which is the hardest case for
        // a missed wake-up.
        let sender = std::thread::spawn(move || {
            for i in 0..20_000 {
                while !pushes.is_empty() {
                    std::hint::spin_loop();
                }
                assert!(pushes.push(i).is_ok());
                wakes.wake();
            }
        });
        for expected in 0..20_000 {
            // A missed wake-up would take the whole minute.
            assert_eq!(
                sleep_for(&queue, &sleeper, Duration::from_secs(60)),
                Some(expected)
            );
        }
        sender.join().unwrap();
    }
}
