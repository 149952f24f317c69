//! Orderly shutdown as a value: every service holds a clone, and any of them can trigger it.

use std::io::Read;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::{flag, low_level};

/// Signal to stop. Clones share one state.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    stopped: AtomicBool,
    lock: Mutex<()>,
    changed: Condvar,
}

impl Stop {
    /// A stop that only [`Stop::trigger`] triggers.
    pub fn new() -> Self {
        Self::default()
    }

    /// A stop that SIGINT and SIGTERM trigger too. A second signal ends the process at once, with
    /// status 130.
    ///
    /// # Errors
    /// The system refused to register a handler.
    pub fn on_signals() -> std::io::Result<Self> {
        let stop = Self::new();
        let again = Arc::new(AtomicBool::new(false));
        let (mut signalled, signal_end) = UnixStream::pair()?;
        for signal in [SIGINT, SIGTERM] {
            // Order matters: the check for a second signal runs before the flag of the first is
            // set.
            flag::register_conditional_shutdown(signal, 130, Arc::clone(&again))?;
            flag::register(signal, Arc::clone(&again))?;
            low_level::pipe::register(signal, signal_end.try_clone()?)?;
        }
        let triggered = stop.clone();
        std::thread::Builder::new()
            .name("signals".into())
            .spawn(move || {
                let mut byte = [0];
                if signalled.read_exact(&mut byte).is_ok() {
                    tracing::info!("stopping in order; a second signal ends at once");
                    triggered.trigger();
                }
            })?;
        Ok(stop)
    }

    /// Whether it was triggered. No lock: for real-time threads.
    pub fn is_stopped(&self) -> bool {
        self.shared.stopped.load(Ordering::Acquire)
    }

    /// Triggers the stop, and wakes all threads that wait for it.
    pub fn trigger(&self) {
        let _guard = self
            .shared
            .lock
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        self.shared.stopped.store(true, Ordering::Release);
        self.shared.changed.notify_all();
    }

    /// Waits for at most `at_most`; true as soon as it is triggered, false if the time is up.
    pub fn wait(&self, at_most: Duration) -> bool {
        let deadline = Instant::now() + at_most;
        let mut guard = self
            .shared
            .lock
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        while !self.is_stopped() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            guard = self
                .shared
                .changed
                .wait_timeout(guard, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trigger_ends_the_waiting_of_a_clone() {
        let stop = Stop::new();
        assert!(!stop.wait(Duration::ZERO));
        let waiting = stop.clone();
        let waiter = std::thread::spawn(move || waiting.wait(Duration::from_secs(60)));
        stop.trigger();
        assert!(waiter.join().unwrap());
        assert!(stop.is_stopped());
    }
}
