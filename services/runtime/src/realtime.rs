//! Real-time set-up of a thread, and in plain words what it got and what to do about what it did
//! not get.

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
    /// Whose set-up this is.
    pub thread: String,
    /// The thread runs under SCHED_FIFO.
    pub scheduled: bool,
    /// The process's memory is locked.
    pub locked: bool,
    /// The thread is pinned as asked, or nothing was asked.
    pub pinned: bool,
    /// Everything above in words, with what to do where something is missing.
    pub words: String,
}

impl RealtimeReport {
    /// Everything that was asked for was got.
    pub fn complete(&self) -> bool {
        self.scheduled && self.locked && self.pinned
    }

    /// For a cell that does not ask for real-time scheduling.
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
/// far as permitted. Never fails: the report says what is missing. Call it after sessions and
/// helper threads are made, since a new thread inherits its maker's scheduling.
pub fn setup_thread(name: &str, priority: u8) -> RealtimeReport {
    setup_thread_on(name, priority, None)
}

/// [`setup_thread`], and keeps the thread on one CPU.
pub fn setup_thread_on(name: &str, priority: u8, cpu: Option<usize>) -> RealtimeReport {
    let (scheduled, scheduling_words) = schedule(priority);
    let (locked, memory_words) = lock_memory();
    let (pinned, cpu_words) = pin(cpu);
    let report = RealtimeReport {
        thread: name.to_owned(),
        scheduled,
        locked,
        pinned,
        words: format!("{name}: {scheduling_words}; {memory_words}{cpu_words}"),
    };
    // What to do about it is said once per process and priority, not once per thread.
    static ADVISED: AtomicU8 = AtomicU8::new(0);
    if report.complete() {
        tracing::info!("{report}");
    } else if ADVISED.fetch_max(priority, Ordering::Relaxed) >= priority {
        let got = if scheduled { "" } else { ", no SCHED_FIFO" };
        let kept = if locked { "" } else { ", memory not locked" };
        tracing::info!("{name}: as said above{got}{kept}");
    } else {
        tracing::warn!("{report}");
    }
    report
}

/// Whether a thread of this process may have SCHED_FIFO with `priority` (1 to 99), tried in a
/// thread that ends with the call.
///
/// # Errors
/// In words, with what to do.
pub fn try_schedule(priority: u8) -> Result<(), String> {
    match in_scheduled_thread(priority, |granted| granted.map(drop)) {
        Some(result) => result,
        None => Err("the thread that tried it panicked; this is a defect".to_owned()),
    }
}

/// Runs `work` in a thread of its own with SCHED_FIFO and `priority` (1 to 99) where that is
/// granted, and waits for it; what came of the scheduling, in words, is handed to `work`. Memory is
/// not locked. None when `work` panicked.
pub fn in_scheduled_thread<T: Send>(
    priority: u8,
    work: impl FnOnce(Result<String, String>) -> T + Send,
) -> Option<T> {
    std::thread::scope(|scope| {
        let thread = scope.spawn(move || {
            let (granted, words) = schedule(priority);
            work(if granted { Ok(words) } else { Err(words) })
        });
        thread.join().ok()
    })
}

/// SCHED_FIFO for the calling thread, and what came of it in words.
fn schedule(priority: u8) -> (bool, String) {
    let in_range = (1..=99).contains(&priority);
    let Some(value) = ThreadPriorityValue::try_from(priority)
        .ok()
        .filter(|_| in_range)
    else {
        return (
            false,
            format!("priority {priority} is not between 1 and 99, normal scheduling"),
        );
    };
    let result = set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    );
    match result {
        Ok(()) => (true, format!("SCHED_FIFO {priority}")),
        Err(error) => (
            false,
            format!(
                "normal scheduling, SCHED_FIFO {priority} was refused ({error:?}): allow it with `rtprio {priority}` in \
                 /etc/security/limits.d, `LimitRTPRIO={priority}` in the systemd unit, or `ulimits: {{ rtprio: {priority} }}` in \
                 the container"
            ),
        ),
    }
}

/// Locks what the process has and will have, once for the whole process.
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
    fn the_report_says_what_was_got_or_what_to_do() {
        // On its own thread: whatever is granted must not colour other tests.
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
    fn what_cannot_be_had_is_said() {
        assert_eq!(
            schedule(0).1,
            "priority 0 is not between 1 and 99, normal scheduling"
        );
        let words = std::thread::spawn(|| pin(Some(900))).join().unwrap();
        assert!(!words.0 && words.1.contains("not on CPU 900"), "{words:?}");
    }
}
