//! Occupies the processors: a thread per core with SCHED_FIFO, which does not yield to lower
//! priorities.

use std::sync::{Arc, Barrier};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::unistd::Pid;
use tangent_runtime::realtime::{in_scheduled_thread, try_schedule};

use crate::error::{Context, FaultsError, Result};

/// Duration: together with our own threads, less than the share of each second that Linux leaves to
/// real-time threads.
const TIME: Duration = Duration::from_millis(500);

/// A waiting thread on each core. Dropping this after the start waits for the threads' end.
pub struct Takers {
    start: Arc<Barrier>,
    threads: Vec<JoinHandle<()>>,
}

impl Takers {
    /// Starts a waiting thread for every core of this process; it occupies nothing yet.
    ///
    /// # Errors
    /// SCHED_FIFO is not granted, or a thread cannot be started.
    pub fn ready(priority: u8) -> Result<Self> {
        try_schedule(priority).map_err(|error| FaultsError::Failed(error.to_string()))?;
        let all = sched_getaffinity(Pid::from_raw(0))?;
        let cores: Vec<usize> = (0..CpuSet::count())
            .filter(|&core| all.is_set(core).unwrap_or(false))
            .collect();
        // All start together: an occupied core may delay the thread that occupies the next.
        let start = Arc::new(Barrier::new(cores.len() + 1));
        let mut threads = Vec::new();
        for core in cores {
            let mut one = CpuSet::new();
            one.set(core)?;
            let start = Arc::clone(&start);
            let thread = std::thread::Builder::new()
                .name("takes-a-core".into())
                .spawn(move || {
                    in_scheduled_thread(priority, |_| take(one, &start));
                })
                .context("a thread that takes a core")?;
            threads.push(thread);
        }
        Ok(Self { start, threads })
    }

    /// Occupies the cores for half a second from now on.
    pub fn start(&self) {
        self.start.wait();
    }
}

impl Drop for Takers {
    fn drop(&mut self) {
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn take(core: CpuSet, start: &Barrier) {
    if let Err(error) = sched_setaffinity(Pid::from_raw(0), &core) {
        tracing::warn!("a thread cannot be pinned to its core: {error}");
    }
    start.wait();
    let until = Instant::now() + TIME;
    while Instant::now() < until {
        std::hint::spin_loop();
    }
}
