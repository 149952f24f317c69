//! Runs tests that depend on real time: as many at a time as this machine has room for, and again
//! if the machine itself stood still or other tests took it.
//!
//! The host of a virtual machine can suspend its processors, at times for a tenth of a second. A
//! task then correctly ends, so the test has no result. Whether that happened is measured during
//! the test, not inferred from its failure.

pub mod interop;
pub mod ports;

use std::cell::Cell;
use std::fmt;
use std::fs::{self, File};
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::unistd::Pid;
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// Longest standstill of the machine that does not invalidate a test: ten periods of the fastest
/// loop.
const STILL_MAX: Duration = Duration::from_millis(10);
/// Largest share of its time that the host may take without invalidating a test.
const STOLEN_MAX: f64 = 0.25;
/// Longest wait of an ordinary thread for a core that does not invalidate a run beside other tests.
/// The other tests can take that much, so the run says nothing about the system under test. A
/// wrench that is older than 20 ms stops the tool, and on its way to a law of another process it
/// passes through four such threads: of its publisher, two of the router, and of its reader.
const WAIT_MAX: Duration = Duration::from_millis(5);
/// Number of tests that run beside each other, per core: a simulated UR at 125 Hz and its services
/// need a tenth to a fifth of one.
const PLACES_PER_CORE: usize = 2;
/// Lock that each test shares which waits for several places, or has all of them.
const ALONE: &str = "alone";
/// Number of runs of a test whose runs are invalidated.
const RUNS: usize = 5;
/// Environment variable with the time from which no run is repeated, in Unix seconds. Repeated runs
/// are alone on the machine: on one that is disturbed all the time, they would take hours.
const REPEAT_UNTIL: &str = "TANGENT_LIVE_REPEAT_UNTIL";
/// SCHED_FIFO priority of the watch, above every thread of ours.
const PRIORITY: u8 = 98;
const PERIOD: Duration = Duration::from_millis(2);
/// Interval at which a test checks for a free place.
const LOOK: Duration = Duration::from_millis(20);

/// Environment variable that names a file to which each run is added as a line: a test runner shows
/// no output of tests that pass.
const LOG: &str = "TANGENT_LIVE_LOG";
const PASSED: &str = "passed in run";
const FAILED: &str = "failed in run";
const NO_VERDICT: &str = "no verdict in run";
const SKIPPED: &str = "skipped, because in the last of its runs,";

/// Runs the test alone on this machine. If it fails while the machine stood still, it runs again;
/// after the last run it prints that it is skipped. Any other failure counts.
pub fn live(test: impl Fn()) {
    let _machine = alone();
    measured(test, |_| Place::alone());
}

/// Runs the test beside other tests of this kind, at most two per core of this machine. For a cell
/// that needs less than half of a core. A repeated run is alone on the machine, as in [`live`].
pub fn live_beside_others(test: impl Fn()) {
    shared_at_first(test, || Some(beside_others()));
}

/// Runs the test beside other tests, in half of this machine's places. For a cell that needs up to
/// a core: one with a camera, or with a loop at 1 kHz. A repeated run is alone on the machine, as
/// in [`live`].
pub fn live_in_half(test: impl Fn()) {
    shared_at_first(test, || Some(half()));
}

/// Runs the test without a place on this machine. For one service, which leaves the machine to
/// others most of the time. A repeated run is alone on the machine, as in [`live`].
pub fn timed(test: impl Fn()) {
    shared_at_first(test, || None);
}

/// Runs the test with these places first, and alone if it is repeated.
fn shared_at_first(test: impl Fn(), places: impl Fn() -> Option<Places>) {
    measured(test, |run| match run {
        1 => Place::shared(places()),
        _ => Place::alone(),
    });
}

fn measured(test: impl Fn(), place: impl Fn(usize) -> Place) {
    verdict(test, runs_max, place, Watch::start, Watch::end, say);
}

/// Where a run takes place.
struct Place {
    _places: Option<Places>,
    /// Whether other tests run on this machine at the same time.
    is_shared: bool,
}

impl Place {
    fn alone() -> Self {
        Self {
            _places: Some(alone()),
            is_shared: false,
        }
    }

    fn shared(places: Option<Places>) -> Self {
        Self {
            _places: places,
            is_shared: true,
        }
    }
}

/// Number of runs that a test may have, as of now.
fn runs_max() -> usize {
    let until = std::env::var(REPEAT_UNTIL).map(|text| {
        let seconds = text.parse().map(Duration::from_secs);
        UNIX_EPOCH + seconds.unwrap_or_else(|_| panic!("{REPEAT_UNTIL}={text}: Unix seconds"))
    });
    match until {
        Ok(until) if SystemTime::now() >= until => 1,
        _ => RUNS,
    }
}

/// Runs the test up to `runs_max` times, which is asked after each run that failed. A run has its
/// `place`, given by its number from 1.
fn verdict<W>(
    test: impl Fn(),
    runs_max: impl Fn() -> usize,
    place: impl Fn(usize) -> Place,
    start: impl Fn() -> W,
    end: impl Fn(W) -> Stood,
    say: impl Fn(&str),
) {
    for run in 1.. {
        let place = place(run);
        let began = Instant::now();
        let watch = start();
        let ended = catch_unwind(AssertUnwindSafe(&test));
        let machine = end(watch);
        let took = began.elapsed().as_secs_f64();
        match ended {
            Ok(()) => return say(&format!("{PASSED} {run} after {took:.1} s: {machine}")),
            Err(failure) if !machine.is_disturbed(place.is_shared) => {
                say(&format!("{FAILED} {run}: {machine}"));
                resume_unwind(failure);
            }
            Err(_) if run < runs_max() => say(&format!("{NO_VERDICT} {run}: {machine}")),
            Err(_) => return say(&format!("{SKIPPED} run {run}, {machine}")),
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

/// The places of a test on this machine, in whatever process it runs. Dropping this frees them.
pub struct Places {
    /// `None` if the thread had a place already.
    locks: Option<Vec<File>>,
}

thread_local! {
    static MINE: Cell<bool> = const { Cell::new(false) };
}

/// Waits until all places of this machine are free, and takes them. A thread that has a place keeps
/// that one. Goes before all tests that need one place, so that the machine is emptied once for all
/// tests that run alone.
pub fn alone() -> Places {
    places(|| {
        let (mut locks, wanted) = several(places_count());
        locks.push(wanted);
        locks
    })
}

/// Waits until half of the places of this machine are free, and takes them. A thread that has a
/// place keeps that one. Goes before all tests that need one place.
pub fn half() -> Places {
    places(|| several(places_count().div_ceil(2)).0)
}

/// Waits for so many places, before all tests that need one, and takes them. Also returns the lock
/// that keeps those tests waiting.
fn several(count: usize) -> (Vec<File>, File) {
    let wanted = lock_file(ALONE);
    wanted.lock_shared().expect("the lock of those that wait");
    // Several places are waited for by one test at a time, so that no two hold a part of theirs.
    let turn = lock_file("queue");
    turn.lock().expect("the queue");
    let mut taken = vec![];
    loop {
        take_free(&mut taken, count);
        if taken.len() == count {
            break;
        }
        std::thread::park_timeout(LOOK);
    }
    (taken, wanted)
}

/// Takes places that are free now, until `taken` are so many.
fn take_free(taken: &mut Vec<File>, count: usize) {
    for place in 0..places_count() {
        if taken.len() == count {
            return;
        }
        let lock = lock_file(&place.to_string());
        if lock.try_lock().is_ok() {
            taken.push(lock);
        }
    }
}

/// Waits until one place of this machine is free, and takes it. A thread that has a place keeps
/// that one.
pub fn beside_others() -> Places {
    places(|| {
        loop {
            // Not while a test waits for several places, or has all of them.
            let nobody_waits = lock_file(ALONE).try_lock().is_ok();
            let mut taken = vec![];
            if nobody_waits {
                take_free(&mut taken, 1);
            }
            if !taken.is_empty() {
                return taken;
            }
            std::thread::park_timeout(LOOK);
        }
    })
}

fn places(take: impl Fn() -> Vec<File>) -> Places {
    if MINE.replace(true) {
        return Places { locks: None };
    }
    Places {
        locks: Some(take()),
    }
}

/// Number of places of this machine.
fn places_count() -> usize {
    PLACES_PER_CORE * std::thread::available_parallelism().map_or(1, usize::from)
}

fn lock_file(name: &str) -> File {
    let path = std::env::temp_dir().join(format!("tangent-live-tests.{name}.lock"));
    File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(path)
        .expect("a lock in the folder for temporary files")
}

impl Drop for Places {
    fn drop(&mut self) {
        if self.locks.is_some() {
            MINE.set(false);
        }
    }
}

/// Threads with the highest priority, one on each core, which detect when it stands still.
struct Watch {
    ends: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Duration>>,
    /// A thread of ordinary priority, which waits for a core as the test's own threads do.
    ordinary: JoinHandle<Duration>,
    stolen_before: Option<Ticks>,
}

/// Standstill of the machine during a test.
struct Stood {
    longest: Duration,
    /// Longest time that an ordinary thread waited for a core.
    waited: Duration,
    stolen: f64,
}

impl Stood {
    /// Whether a failure says nothing about the system under test. An ordinary thread that waits
    /// counts only in a run beside other tests: in a run alone, the system under test is the cause.
    fn is_disturbed(&self, is_shared: bool) -> bool {
        self.longest > STILL_MAX
            || self.stolen > STOLEN_MAX
            || (is_shared && self.waited > WAIT_MAX)
    }
}

impl fmt::Display for Stood {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the machine stood still for up to {} ms, an ordinary thread waited for up to {} ms, \
             and the host took {:.1} % of the machine",
            self.longest.as_millis(),
            self.waited.as_millis(),
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
        let ordinary = std::thread::spawn({
            let ends = Arc::clone(&ends);
            move || longest_delay(&ends)
        });
        Self {
            ends,
            threads,
            ordinary,
            stolen_before: Ticks::now(),
        }
    }

    fn end(self) -> Stood {
        self.ends.store(true, Ordering::Relaxed);
        let longest = self.threads.into_iter().filter_map(|t| t.join().ok());
        Stood {
            longest: longest.max().unwrap_or_default(),
            waited: self.ordinary.join().unwrap_or_default(),
            stolen: self
                .stolen_before
                .zip(Ticks::now())
                .map_or(0.0, |(before, now)| now.stolen_since(&before)),
        }
    }
}

/// Largest delay of a wake-up of a thread on this CPU, until `ends` is set.
fn watch(cpu: usize, ends: &AtomicBool) -> Duration {
    let mut only = CpuSet::new();
    let pinned = only
        .set(cpu)
        .and_then(|()| sched_setaffinity(Pid::from_raw(0), &only));
    pinned.expect("a CPU of this process");
    if !above_all() {
        // It would measure the load of the machine.
        return Duration::ZERO;
    }
    longest_delay(ends)
}

/// Largest delay of a wake-up of the calling thread, until `ends` is set.
fn longest_delay(ends: &AtomicBool) -> Duration {
    let (mut last, mut longest) = (Instant::now(), Duration::ZERO);
    while !ends.load(Ordering::Relaxed) {
        std::thread::sleep(PERIOD);
        longest = longest.max(last.elapsed().saturating_sub(PERIOD));
        last = Instant::now();
    }
    longest
}

/// Sets SCHED_FIFO for the calling thread, if it is granted.
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

/// Time of all CPUs as counted by the kernel.
struct Ticks {
    all: f64,
    stolen: f64,
}

impl Ticks {
    /// `None` if the kernel does not provide it.
    fn now() -> Option<Self> {
        let text = fs::read_to_string("/proc/stat").ok()?;
        let fields = text.lines().next()?.split_whitespace().skip(1);
        // The time of guests, in fields nine and ten, is already contained in the first two.
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

    /// Runs a test that fails the first `failures` times, on a machine that stands still, or lets
    /// an ordinary thread wait, for so long each time; how often it ran. The first run is beside
    /// other tests if `is_shared`.
    fn runs(
        failures: usize,
        longest: Duration,
        waited: Duration,
        is_shared: bool,
    ) -> Result<usize, usize> {
        runs_of_at_most(RUNS, failures, longest, waited, is_shared)
    }

    fn runs_of_at_most(
        runs_max: usize,
        failures: usize,
        longest: Duration,
        waited: Duration,
        is_shared: bool,
    ) -> Result<usize, usize> {
        let ran = Cell::new(0);
        let machine = |()| Stood {
            longest,
            waited,
            stolen: 0.0,
        };
        let test = || {
            ran.set(ran.get() + 1);
            assert!(ran.get() > failures, "fails");
        };
        let place = |run| Place {
            _places: None,
            is_shared: is_shared && run == 1,
        };
        let run = || verdict(test, || runs_max, place, || (), machine, |_| {});
        match catch_unwind(AssertUnwindSafe(run)) {
            Ok(()) => Ok(ran.get()),
            Err(_) => Err(ran.get()),
        }
    }

    #[test]
    fn a_failure_counts_where_the_machine_ran() {
        for shared in [false, true] {
            assert_eq!(runs(0, STILL_MAX, WAIT_MAX, shared), Ok(1));
            assert_eq!(runs(1, STILL_MAX, WAIT_MAX, shared), Err(1));
        }
    }

    #[test]
    fn a_failure_beside_tests_that_took_the_machine_is_tried_again_alone() {
        let waited = 2 * WAIT_MAX;
        assert_eq!(runs(1, STILL_MAX, waited, true), Ok(2));
        assert_eq!(runs(2, STILL_MAX, waited, true), Err(2));
        assert_eq!(runs(1, STILL_MAX, waited, false), Err(1));
    }

    #[test]
    fn a_failure_on_a_machine_that_stood_still_is_tried_again() {
        let still = 2 * STILL_MAX;
        assert_eq!(runs(0, still, WAIT_MAX, false), Ok(1));
        assert_eq!(runs(2, still, WAIT_MAX, false), Ok(3));
        assert_eq!(runs(100, still, WAIT_MAX, false), Ok(RUNS));
    }

    #[test]
    fn a_run_is_not_repeated_when_there_is_no_time_left() {
        let still = 2 * STILL_MAX;
        assert_eq!(runs_of_at_most(1, 100, still, WAIT_MAX, true), Ok(1));
        assert_eq!(runs_of_at_most(1, 0, still, WAIT_MAX, true), Ok(1));
        assert_eq!(runs_of_at_most(1, 1, STILL_MAX, WAIT_MAX, true), Err(1));
    }

    #[test]
    fn a_thread_has_its_place_once() {
        for place in [alone, half, beside_others] {
            let first = place();
            let second = alone();
            let third = beside_others();
            assert!(first.locks.is_some() && second.locks.is_none() && third.locks.is_none());
            drop((third, second));
            assert!(beside_others().locks.is_none());
            drop(first);
        }
        assert!(alone().locks.is_some());
    }

    /// Number of places that another test could take now, with the locks that it would take.
    fn free_places() -> usize {
        let free = |place: &usize| lock_file(&place.to_string()).try_lock().is_ok();
        (0..places_count()).filter(free).count()
    }

    #[test]
    fn a_test_alone_has_all_places_and_one_beside_others_has_one() {
        let machine = alone();
        assert_eq!(free_places(), 0);
        // With the lock that lets it go first.
        let locks = places_count() + 1;
        assert_eq!(machine.locks.as_ref().map(Vec::len), Some(locks));
        drop(machine);
        let place = beside_others();
        assert_eq!(place.locks.as_ref().map(Vec::len), Some(1));
        drop(place);
        let part = half();
        let locks = places_count().div_ceil(2);
        assert_eq!(part.locks.as_ref().map(Vec::len), Some(locks));
    }

    #[test]
    fn tests_alone_go_first() {
        let machine = alone();
        let (ended, ends) = std::sync::mpsc::channel();
        let waits = |name, place: fn() -> Places| {
            let ended = ended.clone();
            std::thread::spawn(move || {
                let place = place();
                ended.send(name).unwrap();
                drop(place);
            })
        };
        let beside = waits("beside others", beside_others);
        std::thread::sleep(5 * LOOK);
        let second = waits("alone", alone);
        std::thread::sleep(5 * LOOK);
        assert!(ends.try_recv().is_err());
        drop(machine);
        assert_eq!(ends.recv(), Ok("alone"));
        assert_eq!(ends.recv(), Ok("beside others"));
        for thread in [beside, second] {
            thread.join().unwrap();
        }
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

    /// Number of tests that may end without a result before the machine counts as unsuitable for
    /// tests.
    const SKIPPED_MAX: usize = 3;

    #[test]
    #[ignore = "after all other tests: .ci/run"]
    fn the_machine_let_tests_come_to_a_verdict() {
        let log = std::env::var_os(LOG).expect("TANGENT_LIVE_LOG is set");
        let text = fs::read_to_string(log).expect("the tests before have written it");
        let shown = [SKIPPED, NO_VERDICT, FAILED];
        for line in text.lines() {
            if shown.iter().any(|what| line.contains(what)) {
                println!("{line}");
            }
        }
        let skipped = text.lines().filter(|line| line.contains(SKIPPED)).count();
        assert!(skipped <= SKIPPED_MAX, "{skipped} tests have no verdict");
        assert!(text.lines().any(|line| line.contains(PASSED)));
    }
}
