//! Time for services: stamps since the Unix epoch, and waiting for deadlines without drift.
//!
//! Age and silence are measured by [`Instant`] (monotonic, never stepped). Stamps in messages are
//! for people, for recordings and for other hosts.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

/// Nanoseconds since the Unix epoch, on this host's clock.
pub fn now_ns() -> i64 {
    match SystemTime::now().duration_since(UNIX_EPOCH) {
        Ok(since) => i64::try_from(since.as_nanos()).unwrap_or(i64::MAX),
        Err(before) => -i64::try_from(before.duration().as_nanos()).unwrap_or(i64::MAX),
    }
}

/// The stamp of an instant of the recent past: now, less its age.
pub fn stamp_ns(instant: Instant) -> i64 {
    let age = instant.elapsed();
    now_ns().saturating_sub(i64::try_from(age.as_nanos()).unwrap_or(i64::MAX))
}

/// Age of a stamp, s, on this host's clock; negative if the stamp is in the future.
pub fn age_s(stamp_ns: i64) -> f64 {
    now_ns().saturating_sub(stamp_ns) as f64 * 1e-9
}

/// Wakes at fixed times, one period apart, however long the work in between takes.
#[derive(Debug)]
pub struct DeadlineClock {
    period_ns: i64,
    next_ns: i64,
}

impl DeadlineClock {
    /// The first deadline is one period from now. A period below 1 µs becomes 1 µs.
    pub fn new(period: Duration) -> Self {
        let period_ns = i64::try_from(period.as_nanos())
            .unwrap_or(i64::MAX / 4)
            .max(1_000);
        Self {
            period_ns,
            next_ns: monotonic_ns().saturating_add(period_ns),
        }
    }

    /// Sleeps until the next deadline and returns how many whole periods were missed before the
    /// call: 0 when in time. Missed deadlines are skipped, not caught up with.
    pub fn wait(&mut self) -> u64 {
        let late = monotonic_ns() - self.next_ns;
        if late > 0 {
            let missed = late / self.period_ns + 1;
            self.next_ns += missed * self.period_ns;
            return missed as u64;
        }
        self.sleep_until_next();
        self.next_ns += self.period_ns;
        0
    }

    fn sleep_until_next(&self) {
        let until = TimeSpec::new(self.next_ns / 1_000_000_000, self.next_ns % 1_000_000_000);
        // A signal may end the sleep early; the deadline is absolute, so simply sleep again.
        while let Err(nix::errno::Errno::EINTR) = clock_nanosleep(
            ClockId::CLOCK_MONOTONIC,
            ClockNanosleepFlags::TIMER_ABSTIME,
            &until,
        ) {}
    }
}

fn monotonic_ns() -> i64 {
    // CLOCK_MONOTONIC exists on every Linux. If it were missing, deadlines at zero would only
    // remove the wait.
    clock_gettime(ClockId::CLOCK_MONOTONIC)
        .map(|time| time.tv_sec() * 1_000_000_000 + time.tv_nsec())
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_are_a_whole_number_of_periods_apart_and_never_early() {
        let period = Duration::from_millis(2);
        let start = Instant::now();
        let mut clock = DeadlineClock::new(period);
        let mut periods = 0;
        for _ in 0..5 {
            periods += clock.wait().max(1);
        }
        assert!(start.elapsed() >= period * (periods as u32 - 1));
    }

    #[test]
    fn a_late_caller_gets_the_number_of_missed_periods() {
        let mut clock = DeadlineClock::new(Duration::from_millis(1));
        clock.next_ns -= 10_000_000;
        assert!(clock.wait() >= 9);
        assert!(clock.next_ns > 0);
    }

    #[test]
    fn the_stamp_of_now_is_now() {
        let before = now_ns();
        let stamp = stamp_ns(Instant::now());
        // A clock step between the lines would break this by more than the bound; NTP slews do not.
        assert!((stamp - before).abs() < 1_000_000_000);
        assert!(age_s(before) >= 0.0);
    }
}
