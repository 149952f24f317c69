//! Hands one piece of work at a time to a thread that must not wait. The work is either done or
//! cancelled without an effect, never both.

use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

const IDLE: u8 = 0;
const ASKED: u8 = 1;
const BEGUN: u8 = 2;
const CALLED_OFF: u8 = 3;
const DONE: u8 = 4;

/// Time that the worker gets, after a cancellation, to report that it had just finished.
const ACKNOWLEDGE: Duration = Duration::from_millis(50);
/// Interval at which the requesting thread checks for the result.
const LOOK: Duration = Duration::from_millis(2);

/// What the worker must do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Nothing new.
    None,
    /// Begin the work.
    Begin,
    /// Discard the work: it must have no effect any more.
    Forget,
}

/// State of the work, shared by the requesting thread and the worker.
#[derive(Debug, Default)]
pub struct Ticket(AtomicU8);

impl Ticket {
    /// Requests the work, and waits until it is done; false if it was cancelled at `deadline`. Only
    /// one thread may request at a time.
    pub fn ask_and_wait(&self, deadline: Instant) -> bool {
        self.0.store(ASKED, Ordering::Release);
        while Instant::now() < deadline {
            if self.take_done() {
                return true;
            }
            std::thread::park_timeout(LOOK);
        }
        self.call_off()
    }

    /// Ends the wait; true if the work was done after all.
    fn call_off(&self) -> bool {
        if self.swap(ASKED, IDLE) {
            return false;
        }
        if self.swap(BEGUN, CALLED_OFF) {
            let until = Instant::now() + ACKNOWLEDGE;
            // The worker may just be finishing. One that is idle now discards the work before it
            // does anything else.
            while self.0.load(Ordering::Acquire) == CALLED_OFF && Instant::now() < until {
                std::thread::park_timeout(LOOK);
            }
        }
        self.take_done()
    }

    fn take_done(&self) -> bool {
        self.swap(DONE, IDLE)
    }

    /// Called by the worker before each step of its work. Takes no lock and allocates nothing.
    pub fn order(&self) -> Order {
        match self.0.load(Ordering::Acquire) {
            ASKED if self.swap(ASKED, BEGUN) => Order::Begin,
            CALLED_OFF if self.swap(CALLED_OFF, IDLE) => Order::Forget,
            _ => Order::None,
        }
    }

    /// Called by the worker: the work has ended, and its result can be read.
    pub fn done(&self) {
        if !self.swap(BEGUN, DONE) {
            self.swap(CALLED_OFF, DONE);
        }
    }

    fn swap(&self, from: u8, to: u8) -> bool {
        self.0
            .compare_exchange(from, to, Ordering::AcqRel, Ordering::Acquire)
            .is_ok()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, AtomicU32};

    use super::*;

    /// Work of a few steps, with deadlines before, during and after it.
    #[test]
    fn work_is_done_or_cancelled_and_never_both() {
        let ticket = Ticket::default();
        let (ended, effects) = (AtomicBool::new(false), AtomicU32::new(0));
        let done = std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut left = 0;
                while !ended.load(Ordering::Acquire) {
                    match ticket.order() {
                        Order::Begin => left = 5,
                        Order::Forget => left = 0,
                        Order::None => {}
                    }
                    if left > 0 {
                        left -= 1;
                        if left == 0 {
                            effects.fetch_add(1, Ordering::AcqRel);
                            ticket.done();
                        }
                    }
                    std::thread::park_timeout(Duration::from_micros(100));
                }
            });
            let mut done = 0;
            for i in 0..400 {
                let before = effects.load(Ordering::Acquire);
                let told = ticket.ask_and_wait(Instant::now() + Duration::from_micros(i * 10));
                done += u32::from(told);
                assert_eq!(
                    effects.load(Ordering::Acquire) - before,
                    u32::from(told),
                    "request {i}"
                );
            }
            ended.store(true, Ordering::Release);
            done
        });
        assert_eq!(effects.load(Ordering::Acquire), done);
    }

    /// Whether the worker began what is then cancelled.
    fn begins_too_late(ticket: &Ticket) -> bool {
        std::thread::scope(|scope| {
            let deadline = Instant::now() + Duration::from_millis(20);
            let asking = scope.spawn(move || ticket.ask_and_wait(deadline));
            let mut begun = false;
            while !begun && !asking.is_finished() {
                begun = ticket.order() == Order::Begin;
                std::thread::yield_now();
            }
            assert!(!asking.join().unwrap());
            begun
        })
    }

    #[test]
    fn a_worker_that_comes_back_later_forgets_first() {
        let ticket = Ticket::default();
        assert!(!ticket.ask_and_wait(Instant::now()));
        assert_eq!(ticket.order(), Order::None);
        // On a busy machine, a request may end before the worker sees it.
        while !begins_too_late(&ticket) {}
        assert_eq!(ticket.order(), Order::Forget);
    }
}
