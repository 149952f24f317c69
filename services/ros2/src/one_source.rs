//! Admission of one publisher at a time, in order, and not too late.
//!
//! The service publishes in the cell under its own id. Without this check, two programs of ROS 2 on
//! one topic would reach the cell as one steady publisher.

use std::time::{Duration, Instant};

use tangent_runtime::Attachment;

/// Silence after which another publisher is accepted; as in the cell.
const SILENCE: Duration = Duration::from_millis(500);
/// Lateness, compared with the fastest message, that marks a message as one of a burst that was
/// held up on its way.
const LATE_NS: i64 = 200_000_000;
/// Time of uninterrupted lateness after which the publisher's clock has changed, and not the way.
const CLOCK_CHANGED: Duration = Duration::from_secs(2);
/// Largest drift between two clocks, ns/s.
const DRIFT_NS_PER_S: f64 = 1e6;

/// Why a message is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Another publisher is in use.
    #[error("a second publisher is refused")]
    SecondPublisher,
    /// Not newer than the last one.
    #[error("a message arrives out of order")]
    OutOfOrder,
    /// Held up on its way.
    #[error("a message comes too late")]
    Late,
    /// It does not say who sent it.
    #[error("a message has no sequence number, time and publisher")]
    Nameless,
}

/// State of the admission.
#[derive(Clone, Debug, Default)]
pub struct OneSource {
    accepted: Option<Accepted>,
    late_since: Option<Instant>,
}

#[derive(Clone, Copy, Debug)]
struct Accepted {
    publisher: [u8; 16],
    sequence: u64,
    at: Instant,
    /// Smallest difference between arrival and publication so far, by two clocks, ns.
    least_delay_ns: i64,
}

impl OneSource {
    /// Judges a message that arrived `at`, which is `at_ns` since the Unix epoch on this host.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn admit(
        &mut self,
        attachment: Option<Attachment>,
        at: Instant,
        at_ns: i64,
    ) -> Result<(), Refusal> {
        let from = attachment
            .filter(|a| a.sequence > 0)
            .ok_or(Refusal::Nameless)?;
        let delay_ns = at_ns.saturating_sub(from.source_time_ns);
        let fresh = Accepted {
            publisher: from.publisher,
            sequence: from.sequence,
            at,
            least_delay_ns: delay_ns,
        };
        let Some(last) = self.accepted else {
            self.accepted = Some(fresh);
            return Ok(());
        };
        let silence = at.saturating_duration_since(last.at);
        if last.publisher != from.publisher {
            if silence < SILENCE {
                return Err(Refusal::SecondPublisher);
            }
            self.late_since = None;
            self.accepted = Some(fresh);
            return Ok(());
        }
        if from.sequence <= last.sequence {
            return Err(Refusal::OutOfOrder);
        }
        let drift_ns = (silence.as_secs_f64() * DRIFT_NS_PER_S) as i64;
        let least_delay_ns = last.least_delay_ns.saturating_add(drift_ns);
        if delay_ns.saturating_sub(least_delay_ns) > LATE_NS {
            let since = *self.late_since.get_or_insert(at);
            if at.saturating_duration_since(since) < CLOCK_CHANGED {
                return Err(Refusal::Late);
            }
            self.accepted = Some(fresh);
        } else {
            self.accepted = Some(Accepted {
                least_delay_ns: least_delay_ns.min(delay_ns),
                ..fresh
            });
        }
        self.late_since = None;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Bench {
        source: OneSource,
        begin: Instant,
    }

    impl Bench {
        fn new() -> Self {
            Self {
                source: OneSource::default(),
                begin: Instant::now(),
            }
        }

        /// A message of `publisher`, published at `sent_ms` by its clock, arriving at `at_ms`.
        fn take(
            &mut self,
            publisher: u8,
            sequence: u64,
            sent_ms: i64,
            at_ms: u64,
        ) -> Result<(), Refusal> {
            let attachment = Attachment {
                sequence,
                source_time_ns: sent_ms * 1_000_000,
                publisher: [publisher; 16],
            };
            let at = self.begin + Duration::from_millis(at_ms);
            let at_ns = i64::try_from(at_ms).unwrap() * 1_000_000;
            self.source.admit(Some(attachment), at, at_ns)
        }
    }

    #[test]
    fn a_second_publisher_waits_until_the_first_is_silent() {
        let mut bench = Bench::new();
        assert_eq!(bench.take(1, 1, 0, 0), Ok(()));
        assert_eq!(bench.take(2, 1, 10, 10), Err(Refusal::SecondPublisher));
        assert_eq!(bench.take(1, 2, 400, 400), Ok(()));
        assert_eq!(bench.take(2, 2, 800, 800), Err(Refusal::SecondPublisher));
        assert_eq!(bench.take(2, 3, 900, 900), Ok(()));
        assert_eq!(bench.take(1, 3, 910, 910), Err(Refusal::SecondPublisher));
    }

    #[test]
    fn order_is_kept_and_the_sender_is_known() {
        let mut bench = Bench::new();
        assert_eq!(bench.take(1, 5, 0, 0), Ok(()));
        assert_eq!(bench.take(1, 5, 1, 1), Err(Refusal::OutOfOrder));
        assert_eq!(bench.take(1, 4, 2, 2), Err(Refusal::OutOfOrder));
        assert_eq!(bench.take(1, 0, 3, 3), Err(Refusal::Nameless));
        let at = bench.begin;
        assert_eq!(bench.source.admit(None, at, 0), Err(Refusal::Nameless));
        assert_eq!(bench.take(1, 6, 4, 4), Ok(()));
    }

    /// A cut of three seconds: what was sent meanwhile arrives at once.
    #[test]
    fn a_burst_that_was_held_up_is_refused_whatever_the_clocks_differ_by() {
        for offset_ms in [0, -3_600_000, 86_400_000] {
            let mut bench = Bench::new();
            for i in 0..50_u64 {
                let sent_ms = i64::try_from(i * 20).unwrap() + offset_ms;
                assert_eq!(bench.take(1, 1 + i, sent_ms, i * 20 + i % 3), Ok(()));
            }
            for i in 50..190_u64 {
                let sent_ms = i64::try_from(i * 20).unwrap() + offset_ms;
                assert_eq!(bench.take(1, 1 + i, sent_ms, 4000), Err(Refusal::Late));
            }
            assert_eq!(bench.take(1, 300, 4000 + offset_ms, 4001), Ok(()));
        }
    }

    #[test]
    fn a_clock_that_was_set_back_is_accepted_after_two_seconds() {
        let mut bench = Bench::new();
        assert_eq!(bench.take(1, 1, 10_000, 0), Ok(()));
        for i in 1..=100_u64 {
            let sent_ms = i64::try_from(i * 20).unwrap();
            assert_eq!(bench.take(1, 1 + i, sent_ms, i * 20), Err(Refusal::Late));
        }
        assert_eq!(bench.take(1, 200, 2020, 2020), Ok(()));
        assert_eq!(bench.take(1, 201, 2040, 2040), Ok(()));
    }
}
