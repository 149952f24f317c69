//! Watchdog for the loops of this process: a loop that stops running ends the process.
//!
//! A loop creates a [`Beat`] when it begins and beats once per turn. A beat is an atomic count, so
//! real-time threads can use it. [`watch`] measures time by its own turns, not by the clock, so
//! that a process that was suspended as a whole (SIGSTOP, a laptop's lid) does not end when it
//! resumes. While every loop beats, systemd's watchdog is notified.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::ending;
use crate::stop::Stop;
use crate::systemd::Notify;

/// Interval between two checks of the loops.
pub const TICK: Duration = Duration::from_millis(100);
/// Time that a loop may take for a turn unless it states another.
pub const TURN: Duration = Duration::from_secs(3);

#[derive(Debug)]
struct Loop {
    name: String,
    beats: AtomicU64,
    /// Number of ticks that the present turn may take.
    allowed: AtomicU32,
    /// Idle: no call is in progress.
    idle: AtomicBool,
    gone: AtomicBool,
}

static LOOPS: Mutex<Vec<Arc<Loop>>> = Mutex::new(Vec::new());

/// Signal of a loop that it is running. A loop that ends drops it.
#[derive(Debug)]
pub struct Beat(Arc<Loop>);

impl Beat {
    /// Beat of the loop `name`, which is watched from now on and may take [`TURN`] for each of its
    /// turns.
    pub fn new(name: &str) -> Self {
        let watched = Arc::new(Loop {
            name: name.to_owned(),
            beats: AtomicU64::new(0),
            allowed: AtomicU32::new(ticks(TURN)),
            idle: AtomicBool::new(false),
            gone: AtomicBool::new(false),
        });
        loops().push(Arc::clone(&watched));
        Self(watched)
    }

    /// Signals that the loop is running. Takes no lock and allocates nothing.
    pub fn beat(&self) {
        self.within(TURN);
    }

    /// Signals that the loop is running, and that its next turn may take as long as `allowed`, as
    /// it waits for a slow partner. Takes no lock and allocates nothing.
    pub fn within(&self, allowed: Duration) {
        self.0.allowed.store(ticks(allowed), Ordering::Relaxed);
        self.0.idle.store(false, Ordering::Relaxed);
        self.0.beats.fetch_add(1, Ordering::Release);
    }

    /// Suspends the watch until the next beat, for any time. Takes no lock and allocates nothing.
    pub fn rest(&self) {
        self.0.idle.store(true, Ordering::Relaxed);
        self.0.beats.fetch_add(1, Ordering::Release);
    }
}

impl Drop for Beat {
    fn drop(&mut self) {
        self.0.gone.store(true, Ordering::Release);
    }
}

fn ticks(time: Duration) -> u32 {
    let ticks = time.as_nanos().div_ceil(TICK.as_nanos());
    // One tick is always in progress.
    u32::try_from(ticks).unwrap_or(u32::MAX - 1) + 1
}

fn loops() -> std::sync::MutexGuard<'static, Vec<Arc<Loop>>> {
    LOOPS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Counts a loop's ticks since its last beat.
struct Count {
    watched: Arc<Loop>,
    beats: u64,
    silent: u32,
}

/// Checks every loop once per [`TICK`].
#[derive(Default)]
struct Watch {
    counts: Vec<Count>,
}

impl Watch {
    /// One tick; names a loop that has stopped running, if any.
    fn tick(&mut self, loops: &mut Vec<Arc<Loop>>) -> Option<String> {
        loops.retain(|watched| !watched.gone.load(Ordering::Acquire));
        self.counts
            .retain(|count| loops.iter().any(|l| Arc::ptr_eq(l, &count.watched)));
        for watched in loops.iter() {
            if !self.counts.iter().any(|c| Arc::ptr_eq(&c.watched, watched)) {
                self.counts.push(Count {
                    watched: Arc::clone(watched),
                    beats: watched.beats.load(Ordering::Acquire),
                    silent: 0,
                });
            }
        }
        for count in &mut self.counts {
            let beats = count.watched.beats.load(Ordering::Acquire);
            if beats != count.beats || count.watched.idle.load(Ordering::Relaxed) {
                count.beats = beats;
                count.silent = 0;
                continue;
            }
            count.silent += 1;
            if count.silent > count.watched.allowed.load(Ordering::Relaxed) {
                let stood = TICK * count.silent;
                return Some(format!(
                    "the loop of {} has not run for {:.1} s: this is a defect, or the machine gives it no processor time; \
                     the process exits",
                    count.watched.name,
                    stood.as_secs_f64()
                ));
            }
        }
        None
    }
}

/// Watches all loops of this process until `stop`, in a separate thread. `notify` is used while all
/// of them run.
///
/// # Errors
/// The system refused a thread.
pub fn watch(stop: &Stop, notify: Option<Notify>) -> std::io::Result<()> {
    let stop = stop.clone();
    std::thread::Builder::new()
        .name("watchdog".into())
        .spawn(move || {
            if let Some(notify) = &notify {
                notify.ready();
            }
            let mut watch = Watch::default();
            while !stop.wait(TICK) {
                let found = watch.tick(&mut loops());
                match (found, &notify) {
                    (None, Some(notify)) => notify.alive(),
                    (None, None) => {}
                    (Some(words), notify) => {
                        // Sent before the end begins: the process may exit right after it.
                        if let Some(notify) = notify {
                            notify.failed(&words);
                            notify.stopping();
                        }
                        ending::end(words);
                        return;
                    }
                }
            }
            if let Some(notify) = &notify {
                notify.stopping();
            }
        })
        .map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A loop that is not in the process's list.
    fn watched(name: &str) -> (Beat, Vec<Arc<Loop>>) {
        let beat = Beat::new(name);
        loops().retain(|l| !Arc::ptr_eq(l, &beat.0));
        let list = vec![Arc::clone(&beat.0)];
        (beat, list)
    }

    #[test]
    fn a_loop_that_beats_is_left_alone_and_one_that_stands_is_named_in_time() {
        let (beat, mut list) = watched("rtde");
        let mut watch = Watch::default();
        for _ in 0..1000 {
            beat.beat();
            assert_eq!(watch.tick(&mut list), None);
        }
        let mut ticks = 0;
        let words = loop {
            ticks += 1;
            if let Some(words) = watch.tick(&mut list) {
                break words;
            }
        };
        assert!(words.contains("the loop of rtde"), "{words}");
        let turn = (TURN.as_nanos() / TICK.as_nanos()) as u32;
        assert!((turn..=turn + 2).contains(&ticks), "{ticks}");
    }

    #[test]
    fn a_loop_may_announce_a_long_wait() {
        let (beat, mut list) = watched("netft");
        let mut watch = Watch::default();
        beat.within(TURN * 4);
        let turn = (TURN.as_nanos() / TICK.as_nanos()) as u32;
        for _ in 0..4 * turn {
            assert_eq!(watch.tick(&mut list), None);
        }
        assert!((0..3).any(|_| watch.tick(&mut list).is_some()));
    }

    #[test]
    fn an_idle_loop_may_be_silent_and_an_ended_loop_is_removed() {
        let (beat, mut list) = watched("controller");
        let mut watch = Watch::default();
        beat.rest();
        for _ in 0..1000 {
            assert_eq!(watch.tick(&mut list), None);
        }
        beat.beat();
        drop(beat);
        for _ in 0..1000 {
            assert_eq!(watch.tick(&mut list), None);
        }
        assert!(list.is_empty() && watch.counts.is_empty());
    }
}
