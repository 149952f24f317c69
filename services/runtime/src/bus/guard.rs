//! Rejects samples that are old, duplicated or out of order, and counts missing ones, per
//! publisher.
//!
//! After a cut shorter than the lease, TCP delivers seconds of queued samples in one burst
//! (measured: 67 samples, up to 2 s old, within 3.5 ms). Sequence alone lets them pass, since they
//! are in order; age stops them, where clocks agree.

use std::time::Duration;

use super::attachment::Attachment;

/// Number of publishers that a typed reader keeps track of; more than ever publish on one key.
const PUBLISHERS: usize = 16;

/// Decision on a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Deliver it.
    Accept {
        /// Number of samples that are missing before it.
        missing: u64,
    },
    /// Duplicate, or older in sequence than one already delivered.
    Overtaken,
    /// Older than the reader accepts.
    TooOld,
}

/// Keeps the last sequence number of each publisher, for a limited number of publishers. Beyond
/// that, the one that has been silent longest is dropped.
#[derive(Debug)]
pub struct Guard {
    capacity: usize,
    /// Publisher's id, last sequence number, and the count of samples seen when its last one
    /// arrived.
    seen: Vec<([u8; 16], u64, u64)>,
    samples: u64,
}

impl Default for Guard {
    fn default() -> Self {
        Self::for_publishers(PUBLISHERS)
    }
}

impl Guard {
    /// For a reader with up to `capacity` publishers at once.
    pub fn for_publishers(capacity: usize) -> Self {
        Self {
            capacity,
            seen: Vec::new(),
            samples: 0,
        }
    }

    /// Discards what is known of the publisher; its next sample is accepted as its first.
    pub fn forget(&mut self, publisher: [u8; 16]) {
        self.seen.retain(|(id, ..)| *id != publisher);
    }

    /// Judges one sample. `now_ns` is the epoch time of its arrival.
    pub fn judge(
        &mut self,
        attachment: &Attachment,
        now_ns: i64,
        age_max: Option<Duration>,
    ) -> Verdict {
        if attachment.sequence == 0 {
            // A sample without attachment cannot be judged; it is refused only if a maximum age is
            // set.
            return match age_max {
                Some(_) => Verdict::TooOld,
                None => Verdict::Accept { missing: 0 },
            };
        }
        self.samples += 1;
        let missing = match self
            .seen
            .iter_mut()
            .find(|(id, ..)| *id == attachment.publisher)
        {
            Some((_, last, heard)) => {
                if attachment.sequence <= *last {
                    return Verdict::Overtaken;
                }
                let missing = attachment.sequence - *last - 1;
                (*last, *heard) = (attachment.sequence, self.samples);
                missing
            }
            None => {
                if self.seen.len() == self.capacity {
                    let silent = (0..self.capacity)
                        .min_by_key(|&i| self.seen[i].2)
                        .unwrap_or(0);
                    self.seen.swap_remove(silent);
                }
                self.seen
                    .push((attachment.publisher, attachment.sequence, self.samples));
                0
            }
        };
        if let Some(age_max) = age_max {
            let age_ns = now_ns.saturating_sub(attachment.source_time_ns);
            if age_ns > i64::try_from(age_max.as_nanos()).unwrap_or(i64::MAX) {
                return Verdict::TooOld;
            }
        }
        Verdict::Accept { missing }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(publisher: u8, sequence: u64, source_time_ns: i64) -> Attachment {
        Attachment {
            sequence,
            source_time_ns,
            publisher: [publisher; 16],
        }
    }

    #[test]
    fn doubles_and_reordered_samples_are_refused_and_gaps_counted() {
        let mut guard = Guard::default();
        let verdicts: Vec<Verdict> = [5, 6, 6, 9, 7, 8, 10]
            .iter()
            .map(|&sequence| guard.judge(&sample(1, sequence, 0), 0, None))
            .collect();
        let accept = |missing| Verdict::Accept { missing };
        assert_eq!(
            verdicts,
            [
                accept(0),
                accept(0),
                Verdict::Overtaken,
                accept(2),
                Verdict::Overtaken,
                Verdict::Overtaken,
                accept(0)
            ]
        );
    }

    #[test]
    fn a_restarted_publisher_counts_anew_and_a_second_one_apart() {
        let mut guard = Guard::default();
        guard.judge(&sample(1, 1000, 0), 0, None);
        assert_eq!(
            guard.judge(&sample(2, 1, 0), 0, None),
            Verdict::Accept { missing: 0 }
        );
        assert_eq!(
            guard.judge(&sample(1, 1002, 0), 0, None),
            Verdict::Accept { missing: 1 }
        );
    }

    #[test]
    fn a_burst_after_a_cut_is_refused_by_age_until_it_is_fresh_again() {
        let mut guard = Guard::default();
        let age_max = Some(Duration::from_millis(40));
        let now = 10_000_000_000;
        for (sequence, age_ms) in [(1, 2000), (2, 1000), (3, 41)] {
            let stamp = now - age_ms * 1_000_000;
            assert_eq!(
                guard.judge(&sample(1, sequence, stamp), now, age_max),
                Verdict::TooOld
            );
        }
        assert_eq!(
            guard.judge(&sample(1, 4, now - 39_000_000), now, age_max),
            Verdict::Accept { missing: 0 }
        );
        assert_eq!(
            guard.judge(&sample(1, 0, now), now, age_max),
            Verdict::TooOld
        );
    }

    #[test]
    fn hostile_ids_do_not_grow_it() {
        let mut guard = Guard::default();
        for publisher in 0..200 {
            guard.judge(&sample(publisher, 1, 0), 0, None);
            guard.judge(&sample(255, u64::from(publisher) + 1, 0), 0, None);
        }
        assert_eq!(guard.seen.len(), PUBLISHERS);
        assert_eq!(
            guard.judge(&sample(255, 3, 0), 0, None),
            Verdict::Overtaken,
            "the one heard most recently must not be forgotten"
        );
    }
}
