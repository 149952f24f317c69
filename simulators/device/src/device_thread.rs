//! Thread of a simulated device, with the two ends of its link: faults in, snapshots out.
//!
//! The handle of a device holds the [`DeviceThread`]; the device itself runs in that thread and
//! holds the [`DeviceLink`].

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_runtime::realtime::setup_thread;

/// A running device with faults `F` and snapshots `S`. Dropping it stops the device and waits for
/// its thread.
pub struct DeviceThread<F, S> {
    faults: Sender<F>,
    snapshot: Arc<Mutex<Option<S>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// The device's end of the link to its handle.
pub struct DeviceLink<F, S> {
    faults: Receiver<F>,
    snapshot: Arc<Mutex<Option<S>>>,
    stop: Arc<AtomicBool>,
}

impl<F: Send + 'static, S: Clone + Send + 'static> DeviceThread<F, S> {
    /// Starts the thread `name`, which calls `run` once; `run` returns when the link is stopped.
    /// `realtime_priority`: SCHED_FIFO priority; `None` for normal scheduling.
    ///
    /// # Errors
    /// The system starts no thread.
    pub fn start(
        name: &str,
        realtime_priority: Option<u8>,
        run: impl FnOnce(DeviceLink<F, S>) + Send + 'static,
    ) -> io::Result<Self> {
        let (faults, receiver) = channel();
        let snapshot = Arc::new(Mutex::new(None));
        let stop = Arc::new(AtomicBool::new(false));
        let link = DeviceLink {
            faults: receiver,
            snapshot: Arc::clone(&snapshot),
            stop: Arc::clone(&stop),
        };
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                if let Some(priority) = realtime_priority {
                    setup_thread("simulated robot", priority);
                }
                run(link);
            })?;
        Ok(Self {
            faults,
            snapshot,
            stop,
            thread: Some(thread),
        })
    }

    /// Provokes or ends a fault in the next cycle.
    pub fn fault(&self, fault: F) {
        // A device that has ended ignores faults.
        let _ = self.faults.send(fault);
    }

    /// A function that provokes faults, for other threads.
    pub fn faults(&self) -> impl Fn(F) + Send + Sync + use<F, S> {
        let faults = self.faults.clone();
        move |fault| {
            let _ = faults.send(fault);
        }
    }

    /// State after the last cycle; `None` before the first.
    pub fn snapshot(&self) -> Option<S> {
        self.snapshot
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Waits until `condition` holds, with one check per millisecond; false if it does not within
    /// `at_most`.
    pub fn wait_for(&self, at_most: Duration, condition: impl Fn(&S) -> bool) -> bool {
        let deadline = Instant::now() + at_most;
        loop {
            if self.snapshot().is_some_and(|s| condition(&s)) {
                return true;
            }
            if Instant::now() >= deadline {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Whether the thread has ended by itself, which it never should.
    pub fn has_ended(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }
}

impl<F, S> Drop for DeviceThread<F, S> {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let Some(thread) = self.thread.take() else {
            return;
        };
        let name = thread.thread().name().unwrap_or_default().to_owned();
        if thread.join().is_err() {
            tracing::error!(target: "simulator", "thread `{name}` failed");
        }
    }
}

impl<F, S> DeviceLink<F, S> {
    /// Whether the handle was dropped; the thread then has to end.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    /// The oldest fault that is not applied yet.
    pub fn next_fault(&self) -> Option<F> {
        self.faults.try_recv().ok()
    }

    /// Publishes the state after a cycle. It never waits: a thread that reads the last snapshot
    /// must not delay the device, and gets the next one.
    pub fn show(&self, snapshot: S) {
        match self.snapshot.try_lock() {
            Ok(mut shown) => *shown = Some(snapshot),
            Err(TryLockError::Poisoned(shown)) => *shown.into_inner() = Some(snapshot),
            Err(TryLockError::WouldBlock) => {}
        }
    }
}
