//! Sequence numbers of one publisher: the last message, and the gaps before it.

use std::time::{Duration, Instant};

use super::Origin;

/// Largest number of gaps of one publisher; beyond it, the oldest stays missing.
pub(super) const GAPS_MAX: usize = 1024;
/// Time within which a message that is only late arrives by itself.
const LATE: Duration = Duration::from_millis(150);

/// Messages of one publisher.
#[derive(Debug)]
pub(super) struct PublisherLine {
    /// Highest sequence number recorded.
    pub last: u64,
    /// Highest sequence number that was recalled. The live message may still arrive.
    pub recalled: u64,
    /// Sequence numbers that are not recorded, in order.
    pub gaps: Vec<Gap>,
    /// Whether only the lower 32 bits of `last` and `gaps` are known, from a file.
    pub short: bool,
    /// Number of messages recorded from all publishers at the last one of this publisher.
    pub heard: u64,
}

/// Range of sequence numbers that are not recorded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gap {
    pub from: u64,
    /// Last number, inclusive.
    pub to: u64,
    /// Number of requests for it so far.
    pub asked: usize,
    /// Time of the next request.
    pub due: Instant,
    /// Whether it counts as missing. Messages before the first one of a publisher may be older than
    /// the recording.
    pub counts: bool,
}

impl Gap {
    /// This gap in parts, of which the one from `from` to `to` counts as missing.
    pub fn claim(&self, from: u64, to: u64) -> impl Iterator<Item = Self> {
        let (begin, end) = (self.from.max(from), self.to.min(to));
        let parts = if self.counts || begin > end {
            [Some((self.from, self.to, self.counts)), None, None]
        } else {
            [
                (self.from < begin).then(|| (self.from, begin - 1, false)),
                Some((begin, end, true)),
                (end < self.to).then(|| (end + 1, self.to, false)),
            ]
        };
        let whole = *self;
        parts
            .into_iter()
            .flatten()
            .map(move |(from, to, counts)| Self {
                from,
                to,
                counts,
                ..whole
            })
    }

    /// Number of messages.
    pub fn length(&self) -> u64 {
        (self.to - self.from).saturating_add(1)
    }
}

impl PublisherLine {
    /// Line that begins with the first message of a publisher.
    pub fn begin(sequence: u64, origin: Origin, heard: u64, now: Instant) -> Self {
        let mut line = Self {
            last: sequence,
            recalled: 0,
            gaps: Vec::new(),
            short: false,
            heard,
        };
        if sequence > 1 {
            line.gaps.push(Gap::new(1, sequence - 1, false, now));
        }
        if origin == Origin::Recalled {
            line.recalled = sequence;
        }
        line
    }

    /// Completes the sequence numbers from their lower 32 bits, with the first live message.
    pub fn lengthen(&mut self, sequence: u64) {
        if !self.short {
            return;
        }
        self.short = false;
        let ahead = (sequence as u32).wrapping_sub(self.last as u32) as i32;
        let last = sequence.wrapping_add_signed(-i64::from(ahead));
        let more = last.saturating_sub(self.last);
        self.last += more;
        for gap in &mut self.gaps {
            gap.from += more;
            gap.to += more;
        }
    }

    /// Appends a message after the last. Returns how many older messages are given up.
    pub fn go_on(&mut self, sequence: u64, counts: bool, now: Instant) -> u64 {
        let mut given_up = 0;
        if sequence > self.last + 1 {
            if self.gaps.len() == GAPS_MAX {
                let oldest = self.gaps.remove(0);
                given_up = if oldest.counts { oldest.length() } else { 0 };
            }
            self.gaps
                .push(Gap::new(self.last + 1, sequence - 1, counts, now));
        }
        self.last = sequence;
        given_up
    }

    /// Removes a message from the gaps. Returns false if it is in none.
    pub fn fill(&mut self, sequence: u64) -> bool {
        let at = self.gaps.partition_point(|gap| gap.to < sequence);
        let Some(gap) = self.gaps.get_mut(at).filter(|gap| gap.from <= sequence) else {
            return false;
        };
        match (gap.from == sequence, gap.to == sequence) {
            (true, true) => {
                self.gaps.remove(at);
            }
            (true, false) => gap.from += 1,
            (false, true) => gap.to -= 1,
            (false, false) => {
                let mut rest = *gap;
                gap.to = sequence - 1;
                rest.from = sequence + 1;
                self.gaps.insert(at + 1, rest);
            }
        }
        true
    }

    /// Number of missing messages.
    pub fn counted(&self) -> u64 {
        let counted = self.gaps.iter().filter(|gap| gap.counts);
        counted.map(Gap::length).fold(0, u64::saturating_add)
    }
}

impl Gap {
    pub fn new(from: u64, to: u64, counts: bool, now: Instant) -> Self {
        Self {
            from,
            to,
            asked: 0,
            due: now + LATE,
            counts,
        }
    }
}
