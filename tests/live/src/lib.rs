//! Tests of what happens in real time: one at a time on this machine, and again where the machine
//! itself stood still.
//!
//! A virtual machine is taken off its processors by its host, at times for a tenth of a second. No
//! robot would be driven by it, a task correctly ends, and the test has said nothing. Whether that
//! happened is measured beside the test, not guessed from its failure.

use std::cell::Cell;
use std::fmt;
use std::fs::{self, File};
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::unistd::Pid;
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// A machine that stood still for longer has spoilt the test: ten periods of the fastest loop.
const STILL_MAX: Duration = Duration::from_millis(10);
/// A machine whose host took more of its time has spoilt the test.
const STOLEN_MAX: f64 = 0.25;
/// How often a spoilt test runs.
const RUNS: usize = 5;
/// Above every thread of ours.
const PRIORITY: u8 = 98;
const PERIOD: Duration = Duration::from_millis(2);

/// File to which each run is added as a line, where this variable names one: a test runner shows
/// nothing of what passes.
const LOG: &str = "TANGENT_LIVE_LOG";
const PASSED: &str = "passed in run";
const NO_VERDICT: &str = "no verdict in run";
const SKIPPED: &str = "skipped, because in the last of";

/// Runs the test alone. Fails as it does, unless the machine stood still meanwhile: then it runs
/// again, and says so; after the last run it says that it is skipped.
pub fn live(test: impl Fn()) {
    let _alone = alone();
    timed(test);
}

/// As [`live`], beside other tests: for one service, which leaves the machine to others most of the
/// time.
pub fn timed(test: impl Fn()) {
    verdict(test, Watch::start, Watch::end, say);
}

fn verdict<W>(
    test: impl Fn(),
    start: impl Fn() -> W,
    end: impl Fn(W) -> Stood,
    say: impl Fn(&str),
) {
    for run in 1..=RUNS {
        let watch = start();
        let ended = catch_unwind(AssertUnwindSafe(&test));
        let machine = end(watch);
        match ended {
            Ok(()) => return say(&format!("{PASSED} {run}: {machine}")),
            Err(failure) if !machine.is_spoilt() => {
                say(&format!("failed in run {run}: {machine}"));
                resume_unwind(failure);
            }
            Err(_) if run < RUNS => say(&format!("{NO_VERDICT} {run}: {machine}")),
            Err(_) => say(&format!("{SKIPPED} {RUNS} runs {machine}")),
        }
    }
}

fn say(what: &str) {
    let thread = std::thread::current();
    let line = format!("{}: {what}", thread.name().unwrap_or("a test"));
    eprintln!("{line}");
    if let Some(path) = std::env::var_os(LOG) {
        let file = File::options().create(true).append(true).open(path);
        let written = file.and_then(|mut file| writeln!(file, "{line}"));
        written.expect("the file that TANGENT_LIVE_LOG names");
    }
}

/// The machine for one test, in whatever process; given back when this is dropped.
pub struct Alone {
    /// None where the thread had it already.
    lock: Option<File>,
}

thread_local! {
    static MINE: Cell<bool> = const { Cell::new(false) };
}

/// Waits until no other test has the machine. A thread that has it already has it.
pub fn alone() -> Alone {
    if MINE.replace(true) {
        return Alone { lock: None };
    }
    let path = std::env::temp_dir().join("tangent-live-tests.lock");
    let lock = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(path)
        .expect("a lock in the folder for temporary files");
    lock.lock().expect("the lock");
    Alone { lock: Some(lock) }
}

impl Drop for Alone {
    fn drop(&mut self) {
        if self.lock.is_some() {
            MINE.set(false);
        }
    }
}

/// Threads above every other, one on each core, which notice when it stands still.
struct Watch {
    ends: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Duration>>,
    stolen_before: Option<Ticks>,
}

/// What the machine did during a test.
struct Stood {
    longest: Duration,
    stolen: f64,
}

impl Stood {
    fn is_spoilt(&self) -> bool {
        self.longest > STILL_MAX || self.stolen > STOLEN_MAX
    }
}

impl fmt::Display for Stood {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the machine stood still for up to {} ms, and its host took {:.1} % of it",
            self.longest.as_millis(),
            100.0 * self.stolen
        )
    }
}

impl Watch {
    fn start() -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let cpus = sched_getaffinity(Pid::from_raw(0)).expect("the CPUs of this process");
        let threads = (0..CpuSet::count())
            .filter(|&cpu| cpus.is_set(cpu).unwrap_or(false))
            .map(|cpu| {
                let ends = Arc::clone(&ends);
                std::thread::spawn(move || watch(cpu, &ends))
            })
            .collect();
        Self {
            ends,
            threads,
            stolen_before: Ticks::now(),
        }
    }

    fn end(self) -> Stood {
        self.ends.store(true, Ordering::Relaxed);
        let longest = self.threads.into_iter().filter_map(|t| t.join().ok());
        Stood {
            longest: longest.max().unwrap_or_default(),
            stolen: self
                .stolen_before
                .zip(Ticks::now())
                .map_or(0.0, |(before, now)| now.stolen_since(&before)),
        }
    }
}

/// By how much a thread on this CPU woke too late at most, until `ends`.
fn watch(cpu: usize, ends: &AtomicBool) -> Duration {
    let mut only = CpuSet::new();
    let pinned = only
        .set(cpu)
        .and_then(|()| sched_setaffinity(Pid::from_raw(0), &only));
    pinned.expect("a CPU of this process");
    if !above_all() {
        // It would measure how busy the machine is.
        return Duration::ZERO;
    }
    let (mut last, mut longest) = (Instant::now(), Duration::ZERO);
    while !ends.load(Ordering::Relaxed) {
        std::thread::sleep(PERIOD);
        longest = longest.max(last.elapsed().saturating_sub(PERIOD));
        last = Instant::now();
    }
    longest
}

/// SCHED_FIFO for the calling thread, where it is granted.
fn above_all() -> bool {
    let Ok(priority) = ThreadPriorityValue::try_from(PRIORITY) else {
        return false;
    };
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(priority),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .is_ok()
}

/// Time of all CPUs as the kernel counts it.
struct Ticks {
    all: f64,
    stolen: f64,
}

impl Ticks {
    /// None where the kernel does not say.
    fn now() -> Option<Self> {
        let text = fs::read_to_string("/proc/stat").ok()?;
        let fields = text.lines().next()?.split_whitespace().skip(1);
        // Guests' time, in the ninth and tenth, is in the first two already.
        let ticks: Vec<f64> = fields.take(8).filter_map(|t| t.parse().ok()).collect();
        Some(Self {
            all: ticks.iter().sum(),
            stolen: *ticks.get(7)?,
        })
    }

    fn stolen_since(&self, before: &Self) -> f64 {
        (self.stolen - before.stolen) / (self.all - before.all).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs a test that fails the first `failures` times, on a machine that stands still for so
    /// long each time; how often it ran.
    fn runs(failures: usize, longest: Duration) -> Result<usize, usize> {
        let ran = Cell::new(0);
        let machine = |()| Stood {
            longest,
            stolen: 0.0,
        };
        let test = || {
            ran.set(ran.get() + 1);
            assert!(ran.get() > failures, "fails");
        };
        match catch_unwind(AssertUnwindSafe(|| verdict(test, || (), machine, |_| {}))) {
            Ok(()) => Ok(ran.get()),
            Err(_) => Err(ran.get()),
        }
    }

    #[test]
    fn a_failure_counts_where_the_machine_ran() {
        assert_eq!(runs(0, STILL_MAX), Ok(1));
        assert_eq!(runs(1, STILL_MAX), Err(1));
    }

    #[test]
    fn a_failure_on_a_machine_that_stood_still_is_tried_again() {
        let still = 2 * STILL_MAX;
        assert_eq!(runs(0, still), Ok(1));
        assert_eq!(runs(2, still), Ok(3));
        assert_eq!(runs(100, still), Ok(RUNS));
    }

    #[test]
    fn a_thread_has_the_machine_once() {
        let first = alone();
        let second = alone();
        assert!(first.lock.is_some() && second.lock.is_none());
        drop(second);
        drop(first);
        assert!(alone().lock.is_some());
    }

    /// The watch sees what a kernel shows: it ends, and no wake-up is before its time.
    #[test]
    fn the_watch_ends_and_says_how_long() {
        let watch = Watch::start();
        let cpus = watch.threads.len();
        std::thread::sleep(Duration::from_millis(20));
        let machine = watch.end();
        assert!(cpus > 0);
        assert!((0.0..=1.0).contains(&machine.stolen), "{machine}");
    }

    /// Tests that may end without a verdict before the machine is no machine to test on.
    const SKIPPED_MAX: usize = 3;

    #[test]
    #[ignore = "after all other tests: .ci/run"]
    fn the_machine_let_tests_come_to_a_verdict() {
        let log = std::env::var_os(LOG).expect("TANGENT_LIVE_LOG is set");
        let text = fs::read_to_string(log).expect("the tests before have written it");
        let is_spoilt = |line: &&str| line.contains(SKIPPED) || line.contains(NO_VERDICT);
        for line in text.lines().filter(is_spoilt) {
            println!("{line}");
        }
        let skipped = text.lines().filter(|line| line.contains(SKIPPED)).count();
        assert!(skipped <= SKIPPED_MAX, "{skipped} tests have no verdict");
        assert!(text.lines().any(|line| line.contains(PASSED)));
    }
}
