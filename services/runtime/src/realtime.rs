//! Real-time set-up of a thread, with a report of what was granted and how to obtain the rest.

use std::fmt;
use std::sync::atomic::{AtomicU8, Ordering};

use nix::sched::{CpuSet, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::unistd::Pid;
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// What the real-time set-up of one thread achieved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RealtimeReport {
    /// Name of the thread.
    pub thread: String,
    /// Whether the thread runs under SCHED_FIFO.
    pub scheduled: bool,
    /// Whether the process's memory is locked.
    pub locked: bool,
    /// Whether the thread is pinned as requested; true if nothing was requested.
    pub pinned: bool,
    /// All results in words, with advice on what is missing.
    pub words: String,
}

impl RealtimeReport {
    /// Whether all requests were granted.
    pub fn complete(&self) -> bool {
        self.scheduled && self.locked && self.pinned
    }

    /// Report for a cell that does not request real-time scheduling.
    pub fn not_asked(thread: &str) -> Self {
        Self {
            thread: thread.to_owned(),
            scheduled: false,
            locked: false,
            pinned: true,
            words: format!("{thread}: normal scheduling ([realtime] enabled = false)"),
        }
    }
}

impl fmt::Display for RealtimeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words)
    }
}

/// Gives the calling thread SCHED_FIFO with `priority` (1 to 99) and locks the process's memory, as
/// far as permitted. Never fails: the report lists what is missing. Call it after sessions and
/// helper threads have been created, since a new thread inherits the scheduling of its creator.
pub fn setup_thread(name: &str, priority: u8) -> RealtimeReport {
    setup_thread_on(name, priority, None)
}

/// Calls [`setup_thread`], and pins the thread to one CPU if given.
pub fn setup_thread_on(name: &str, priority: u8, cpu: Option<usize>) -> RealtimeReport {
    let scheduling = schedule(priority);
    let scheduled = scheduling.is_ok();
    let scheduling_words = match scheduling {
        Ok(()) => format!("SCHED_FIFO {priority}"),
        Err(error) => error.to_string(),
    };
    let (locked, memory_words) = lock_memory();
    let (pinned, cpu_words) = pin(cpu);
    let report = RealtimeReport {
        thread: name.to_owned(),
        scheduled,
        locked,
        pinned,
        words: format!("{name}: {scheduling_words}; {memory_words}{cpu_words}"),
    };
    // The advice is given once per process and priority, not once per thread.
    static ADVISED: AtomicU8 = AtomicU8::new(0);
    if report.complete() {
        tracing::info!("{report}");
    } else if ADVISED.fetch_max(priority, Ordering::Relaxed) >= priority {
        let got = if scheduled { "" } else { ", no SCHED_FIFO" };
        let kept = if locked { "" } else { ", memory not locked" };
        tracing::info!("{name}: scheduling and memory as reported for the first thread{got}{kept}");
    } else {
        tracing::warn!("{report}");
    }
    report
}

/// Errors of SCHED_FIFO scheduling, with what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScheduleError {
    /// The priority does not exist.
    #[error("priority {0} is not between 1 and 99, normal scheduling")]
    Priority(u8),
    /// The system refused the priority.
    #[error(
        "normal scheduling, SCHED_FIFO {priority} was refused ({reason}): allow it with `rtprio {priority}` in \
         /etc/security/limits.d, `LimitRTPRIO={priority}` in the systemd unit, or `ulimits: {{ rtprio: {priority} }}` in \
         the container"
    )]
    Refused {
        /// Priority requested.
        priority: u8,
        /// The system's reason.
        reason: String,
    },
    /// The thread panicked, which is a defect.
    #[error("the thread that tried it panicked; this is a defect")]
    Panicked,
}

/// Checks whether a thread of this process may have SCHED_FIFO with `priority` (1 to 99), in a
/// thread that ends with the call.
///
/// # Errors
/// [`ScheduleError`], with what to do.
pub fn try_schedule(priority: u8) -> Result<(), ScheduleError> {
    in_scheduled_thread(priority, |granted| granted).unwrap_or(Err(ScheduleError::Panicked))
}

/// Runs `work` in a separate thread, with SCHED_FIFO and `priority` (1 to 99) if that is granted,
/// and waits for it. `work` gets the result of the scheduling. Memory is not locked. `None` if
/// `work` panicked.
pub fn in_scheduled_thread<T: Send>(
    priority: u8,
    work: impl FnOnce(Result<(), ScheduleError>) -> T + Send,
) -> Option<T> {
    std::thread::scope(|scope| scope.spawn(move || work(schedule(priority))).join().ok())
}

/// Sets SCHED_FIFO for the calling thread.
fn schedule(priority: u8) -> Result<(), ScheduleError> {
    let in_range = (1..=99).contains(&priority);
    let value = ThreadPriorityValue::try_from(priority)
        .ok()
        .filter(|_| in_range)
        .ok_or(ScheduleError::Priority(priority))?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|error| ScheduleError::Refused {
        priority,
        reason: format!("{error:?}"),
    })
}

/// Locks the process's present and future memory, once for the whole process.
fn lock_memory() -> (bool, String) {
    match mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE) {
        Ok(()) => (true, "memory locked".to_owned()),
        Err(error) => (
            false,
            format!(
                "memory not locked ({error}): allow it with `memlock unlimited` in /etc/security/limits.d, \
                 `LimitMEMLOCK=infinity` in the systemd unit, or `ulimits: {{ memlock: -1 }}` in the container"
            ),
        ),
    }
}

fn pin(cpu: Option<usize>) -> (bool, String) {
    let Some(cpu) = cpu else {
        return (true, String::new());
    };
    let mut set = CpuSet::new();
    let result = set
        .set(cpu)
        .and_then(|()| sched_setaffinity(Pid::from_raw(0), &set));
    match result {
        Ok(()) => (true, format!("; on CPU {cpu}")),
        Err(error) => (
            false,
            format!(
                "; not on CPU {cpu} ({error}): choose one that this machine and its cpuset have"
            ),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_states_what_was_granted_or_what_to_do() {
        // Runs in its own thread, so that its scheduling does not affect other tests.
        let report = std::thread::spawn(|| setup_thread("loop", 10))
            .join()
            .unwrap();
        assert!(report.words.starts_with("loop: "));
        assert_eq!(
            report.scheduled,
            report.words.contains("loop: SCHED_FIFO 10")
        );
        assert_eq!(!report.scheduled, report.words.contains("LimitRTPRIO=10"));
        assert_eq!(!report.locked, report.words.contains("LimitMEMLOCK"));
    }

    #[test]
    fn refused_settings_are_reported() {
        assert_eq!(
            schedule(0).unwrap_err().to_string(),
            "priority 0 is not between 1 and 99, normal scheduling"
        );
        let words = std::thread::spawn(|| pin(Some(900))).join().unwrap();
        assert!(!words.0 && words.1.contains("not on CPU 900"), "{words:?}");
    }
}
