//! Account of recorded and missing messages by publisher and sequence number, and the requests for
//! the missing ones.
//!
//! It has no clock and no connection: the service enters every message with its time, and sends the
//! requests.

mod line;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tangent_runtime::{Question, SPANS_MAX, Span};

use self::line::{Gap, PublisherLine};

/// Largest number of publishers; beyond it, the one that has been silent for longest is forgotten.
const LINES_MAX: usize = 4096;
/// Times between successive requests for the same messages. After the last request, they stay
/// missing.
const AGAIN: [Duration; 3] = [
    Duration::from_millis(300),
    Duration::from_millis(1000),
    Duration::from_millis(2500),
];

/// Source of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Origin {
    /// Received when it was published.
    Live,
    /// Sent again by its publisher on request.
    Recalled,
}

/// Identity of one message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry<'a> {
    pub key: &'a Arc<str>,
    pub publisher: [u8; 16],
    /// Sequence number; 0 if the publisher has none.
    pub sequence: u64,
    pub origin: Origin,
}

/// Recorded and missing messages, by key and publisher.
pub(crate) struct Ledger {
    lines: HashMap<(Arc<str>, [u8; 16]), PublisherLine>,
    /// Time from which messages of new publishers are requested, ns since the Unix epoch.
    since_ns: i64,
    taken: u64,
    recovered: u64,
    missing: u64,
}

impl Ledger {
    pub(crate) fn new(since_ns: i64) -> Self {
        Self {
            lines: HashMap::new(),
            since_ns,
            taken: 0,
            recovered: 0,
            missing: 0,
        }
    }

    /// Sets the time from which messages of new publishers are requested, ns since the Unix epoch.
    pub(crate) fn since(&mut self, since_ns: i64) {
        self.since_ns = since_ns;
    }

    /// Number of messages recorded on request.
    pub(crate) fn recovered(&self) -> u64 {
        self.recovered
    }

    /// Number of messages requested without success.
    pub(crate) fn missing(&self) -> u64 {
        self.missing
    }

    /// Enters a publisher's messages in a former file: the lower 32 bits of their sequence numbers,
    /// in the order of the file. Gaps count as missing if `counts`.
    pub(crate) fn seed(
        &mut self,
        key: &Arc<str>,
        publisher: [u8; 16],
        sequences: impl IntoIterator<Item = u32>,
        counts: bool,
        now: Instant,
    ) {
        let mut sequences = sequences.into_iter().map(u64::from);
        let Some(first) = sequences.next() else {
            return;
        };
        let mut line = PublisherLine {
            last: first,
            recalled: 0,
            gaps: Vec::new(),
            short: true,
            heard: self.taken,
        };
        for sequence in sequences {
            if sequence > line.last {
                let given_up = line.go_on(sequence, counts, now);
                self.missing = self.missing.saturating_add(given_up);
            } else {
                line.fill(sequence);
            }
        }
        self.lines.insert((Arc::clone(key), publisher), line);
    }

    /// Enters a message. Returns false if it is already recorded.
    pub(crate) fn take(&mut self, entry: Entry<'_>, now: Instant) -> bool {
        let Entry {
            sequence, origin, ..
        } = entry;
        if sequence == 0 {
            return true;
        }
        self.taken += 1;
        let id = (Arc::clone(entry.key), entry.publisher);
        let Some(line) = self.lines.get_mut(&id) else {
            self.make_room();
            self.lines
                .insert(id, PublisherLine::begin(sequence, origin, self.taken, now));
            self.recovered += u64::from(origin == Origin::Recalled);
            return true;
        };
        line.heard = self.taken;
        line.lengthen(sequence);
        let new = if sequence > line.last {
            let given_up = line.go_on(sequence, true, now);
            self.missing = self.missing.saturating_add(given_up);
            true
        } else if line.fill(sequence) {
            true
        } else {
            // A publisher that repeats a sequence number is recorded as received.
            origin == Origin::Live && sequence > line.recalled
        };
        if origin == Origin::Recalled {
            line.recalled = line.recalled.max(sequence);
            self.recovered += u64::from(new);
        }
        new
    }

    /// Enters messages that were dropped from the recorder's full queue.
    pub(crate) fn pushed_out(
        &mut self,
        key: &Arc<str>,
        publisher: [u8; 16],
        from: u64,
        to: u64,
        now: Instant,
    ) {
        if from == 0 || to < from {
            self.missing += u64::from(from == 0);
            return;
        }
        let id = (Arc::clone(key), publisher);
        match self.lines.get_mut(&id) {
            Some(line) => {
                // Gaps between two messages count already; one before the first counts from now on.
                let gaps = std::mem::take(&mut line.gaps);
                line.gaps = gaps.iter().flat_map(|gap| gap.claim(from, to)).collect();
            }
            None => {
                self.make_room();
                let line = PublisherLine {
                    last: to,
                    recalled: 0,
                    gaps: vec![Gap::new(from, to, true, now)],
                    short: false,
                    heard: self.taken,
                };
                self.lines.insert(id, line);
            }
        }
    }

    fn make_room(&mut self) {
        if self.lines.len() < LINES_MAX {
            return;
        }
        let silent = self.lines.iter().min_by_key(|(_, line)| line.heard);
        if let Some(id) = silent.map(|(id, _)| id.clone())
            && let Some(line) = self.lines.remove(&id)
        {
            self.missing = self.missing.saturating_add(line.counted());
        }
    }

    /// Whether a request is due.
    pub(crate) fn is_due(&self, now: Instant) -> bool {
        let mut gaps = self.lines.values().flat_map(|line| &line.gaps);
        gaps.any(|gap| gap.due <= now)
    }

    /// Request that is due now: for gaps whose time has come and, with `since_ns`, for all messages
    /// after the recorded ones and those of new publishers since then. Gaps whose requests are used
    /// up are given up.
    pub(crate) fn question(&mut self, since_ns: Option<i64>, now: Instant) -> Option<Question> {
        let spans = self.spans(since_ns.is_some(), |gap| gap.due <= now, now);
        let question = Question {
            others_since_ns: since_ns.unwrap_or(i64::MAX),
            spans,
        };
        (since_ns.is_some() || !question.spans.is_empty()).then_some(question)
    }

    /// Request at the end of a recording, for all gaps and for what each recorded publisher has
    /// sent after its last recorded message: no later message shows that those did not arrive.
    pub(crate) fn last_question(&mut self, now: Instant) -> Option<Question> {
        let question = Question {
            others_since_ns: i64::MAX,
            spans: self.spans(true, |_| true, now),
        };
        (!question.spans.is_empty()).then_some(question)
    }

    /// Spans of the gaps that are due and, with `tails`, of the messages after the recorded ones.
    fn spans(&mut self, tails: bool, is_due: impl Fn(&Gap) -> bool, now: Instant) -> Vec<Span> {
        let mut spans = Vec::new();
        for ((_, publisher), line) in &mut self.lines {
            let mut kept = Vec::with_capacity(line.gaps.len());
            for mut gap in std::mem::take(&mut line.gaps) {
                if !is_due(&gap) || spans.len() >= SPANS_MAX {
                    kept.push(gap);
                    continue;
                }
                let Some(again) = AGAIN.get(gap.asked) else {
                    let given_up = if gap.counts { gap.length() } else { 0 };
                    self.missing = self.missing.saturating_add(given_up);
                    continue;
                };
                spans.push(Span {
                    publisher: *publisher,
                    from: gap.from,
                    to: gap.to,
                    since_ns: if gap.counts { i64::MIN } else { self.since_ns },
                });
                gap.asked += 1;
                gap.due = now + *again;
                kept.push(gap);
            }
            line.gaps = kept;
            if tails && spans.len() < SPANS_MAX {
                spans.push(Span {
                    publisher: *publisher,
                    from: line.last + 1,
                    to: u64::MAX,
                    since_ns: i64::MIN,
                });
            }
        }
        spans
    }

    /// Closes the account: all gaps stay missing.
    pub(crate) fn close(&mut self) {
        let counted = self.lines.values().map(PublisherLine::counted);
        self.missing = counted.fold(self.missing, u64::saturating_add);
        self.lines.clear();
    }
}

#[cfg(test)]
mod tests;
