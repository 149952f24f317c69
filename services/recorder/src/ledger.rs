//! Which messages of each publisher are recorded, which are missing, and when to ask for those
//! again.
//!
//! Judged by sequence, without a clock of its own: the service says what it takes, asks what this
//! wants, and says when an answer is complete.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tangent_runtime::{Question, SPANS_MAX, Span};

/// Publishers that are followed; beyond it the one silent longest is forgotten.
const LINES_MAX: usize = 4096;
/// Holes of one publisher that are followed; beyond it the oldest stays missing.
const GAPS_MAX: usize = 1024;
/// What is only late comes by itself within this time.
const LATE: Duration = Duration::from_millis(150);
/// From one question for the same messages to the next; after the last one they stay missing.
const AGAIN: [Duration; 3] = [
    Duration::from_millis(300),
    Duration::from_millis(1000),
    Duration::from_millis(2500),
];

/// Where a message comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Origin {
    /// The bus, as it was published.
    Live,
    /// A publisher that was asked for it.
    Recalled,
}

/// One message, as the ledger sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry<'a> {
    pub key: &'a Arc<str>,
    pub publisher: [u8; 16],
    /// 0 for a publisher that does not count.
    pub sequence: u64,
    pub origin: Origin,
}

/// What one publisher said.
#[derive(Debug)]
struct Line {
    last: u64,
    /// Highest sequence that was recalled: the same may still come live.
    recalled: u64,
    /// Not recorded, in order.
    gaps: Vec<Gap>,
    /// Of `last` and `gaps` only the lower 32 bits are known, from a file.
    short: bool,
    /// Messages taken from all publishers when this one spoke last.
    heard: u64,
}

#[derive(Clone, Copy, Debug)]
struct Gap {
    from: u64,
    to: u64,
    /// Times it was asked for.
    asked: usize,
    due: Instant,
    /// It is known that it should have arrived; before a publisher's first message nobody
    /// knows.
    counts: bool,
}

impl Gap {
    /// The part from `from` to `to` counts from now on.
    fn claim(&self, from: u64, to: u64) -> impl Iterator<Item = Self> {
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

    fn length(&self) -> u64 {
        (self.to - self.from).saturating_add(1)
    }
}

/// What is recorded, by publisher.
pub(crate) struct Ledger {
    lines: HashMap<(Arc<str>, [u8; 16]), Line>,
    /// Of publishers heard for the first time: nothing from before is asked for, ns since the Unix
    /// epoch.
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

    /// Publishers heard for the first time are asked for what they published since.
    pub(crate) fn since(&mut self, since_ns: i64) {
        self.since_ns = since_ns;
    }

    /// Messages recorded because they were asked for.
    pub(crate) fn recovered(&self) -> u64 {
        self.recovered
    }

    /// Messages that were asked for in vain.
    pub(crate) fn missing(&self) -> u64 {
        self.missing
    }

    /// A publisher's messages in a former file, in the file's order: the lower 32 bits of their
    /// sequences. Holes in it count as missing when `counts`.
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
        let mut line = Line {
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

    /// Takes a message; false when it is recorded already.
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
                .insert(id, Line::begin(sequence, origin, self.taken, now));
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
            // A publisher that says the same twice is recorded as it is heard.
            origin == Origin::Live && sequence > line.recalled
        };
        if origin == Origin::Recalled {
            line.recalled = line.recalled.max(sequence);
            self.recovered += u64::from(new);
        }
        new
    }

    /// Messages that went unread from the recorder's own queue.
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
                // What lies between two messages is known to be missing; what lies before the first
                // is from now on.
                let gaps = std::mem::take(&mut line.gaps);
                line.gaps = gaps.iter().flat_map(|gap| gap.claim(from, to)).collect();
            }
            None => {
                self.make_room();
                let line = Line {
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

    /// Something is to be asked for now.
    pub(crate) fn is_due(&self, now: Instant) -> bool {
        let mut gaps = self.lines.values().flat_map(|line| &line.gaps);
        gaps.any(|gap| gap.due <= now)
    }

    /// What to ask for now: holes whose time has come, and with `since_ns` all that was published
    /// after what is recorded, by publishers not yet heard since that time. Holes that were asked
    /// for often enough are given up.
    pub(crate) fn question(&mut self, since_ns: Option<i64>, now: Instant) -> Option<Question> {
        let mut spans = Vec::new();
        for ((_, publisher), line) in &mut self.lines {
            let mut kept = Vec::with_capacity(line.gaps.len());
            for mut gap in std::mem::take(&mut line.gaps) {
                if gap.due > now || spans.len() >= SPANS_MAX {
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
            if since_ns.is_some() && spans.len() < SPANS_MAX {
                spans.push(Span {
                    publisher: *publisher,
                    from: line.last + 1,
                    to: u64::MAX,
                    since_ns: i64::MIN,
                });
            }
        }
        let others_since_ns = since_ns.unwrap_or(i64::MAX);
        let question = Question {
            others_since_ns,
            spans,
        };
        (since_ns.is_some() || !question.spans.is_empty()).then_some(question)
    }

    /// Nothing comes any more: everything that is not there stays missing.
    pub(crate) fn close(&mut self) {
        let counted = self.lines.values().map(Line::counted);
        self.missing = counted.fold(self.missing, u64::saturating_add);
        self.lines.clear();
    }
}

impl Line {
    fn begin(sequence: u64, origin: Origin, heard: u64, now: Instant) -> Self {
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

    /// From the lower 32 bits to all of them, by the first message that has all.
    fn lengthen(&mut self, sequence: u64) {
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

    /// The next message is beyond the last. How many more are given up.
    fn go_on(&mut self, sequence: u64, counts: bool, now: Instant) -> u64 {
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

    /// False when the message is not missing.
    fn fill(&mut self, sequence: u64) -> bool {
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

    fn counted(&self) -> u64 {
        let counted = self.gaps.iter().filter(|gap| gap.counts);
        counted.map(Gap::length).fold(0, u64::saturating_add)
    }
}

impl Gap {
    fn new(from: u64, to: u64, counts: bool, now: Instant) -> Self {
        Self {
            from,
            to,
            asked: 0,
            due: now + LATE,
            counts,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [u8; 16] = [1; 16];

    struct Bench {
        ledger: Ledger,
        key: Arc<str>,
        now: Instant,
    }

    impl Bench {
        fn new() -> Self {
            Self {
                ledger: Ledger::new(100),
                key: "arm/state".into(),
                now: Instant::now(),
            }
        }

        fn take(&mut self, sequence: u64, origin: Origin) -> bool {
            let entry = Entry {
                key: &self.key,
                publisher: A,
                sequence,
                origin,
            };
            self.ledger.take(entry, self.now)
        }

        fn live(&mut self, sequences: impl IntoIterator<Item = u64>) -> Vec<bool> {
            let all = sequences.into_iter();
            all.map(|s| self.take(s, Origin::Live)).collect()
        }

        fn wait(&mut self, ms: u64) {
            self.now += Duration::from_millis(ms);
        }

        /// Spans of the question that is due now, as first and last.
        fn asked(&mut self) -> Vec<(u64, u64)> {
            let question = self.ledger.question(None, self.now);
            let spans = question.map(|q| q.spans).unwrap_or_default();
            spans.iter().map(|s| (s.from, s.to)).collect()
        }

        fn figures(&self) -> (u64, u64) {
            (self.ledger.recovered(), self.ledger.missing())
        }
    }

    #[test]
    fn what_is_missing_is_asked_for_and_taken_once() {
        let mut bench = Bench::new();
        assert_eq!(bench.live([1, 2, 6, 7]), [true; 4]);
        assert_eq!(bench.asked(), []);
        bench.wait(150);
        assert_eq!(bench.asked(), [(3, 5)]);
        assert_eq!(bench.asked(), [], "it is under way");
        for (sequence, new) in [(4, true), (4, false), (3, true), (2, false), (5, true)] {
            assert_eq!(bench.take(sequence, Origin::Recalled), new, "{sequence}");
        }
        bench.wait(60_000);
        assert_eq!(bench.asked(), []);
        assert_eq!(bench.figures(), (3, 0));
    }

    #[test]
    fn what_nobody_has_stays_missing() {
        let mut bench = Bench::new();
        bench.live([1, 5]);
        for ms in [150, 300, 1000] {
            bench.wait(ms);
            assert_eq!(bench.asked(), [(2, 4)]);
            assert_eq!(bench.figures(), (0, 0), "it is not lost yet");
        }
        bench.take(3, Origin::Recalled);
        bench.wait(2500);
        assert_eq!(bench.asked(), []);
        assert_eq!(bench.figures(), (1, 2));
    }

    #[test]
    fn what_comes_late_by_itself_is_neither_missing_nor_recovered() {
        let mut bench = Bench::new();
        assert_eq!(bench.live([1, 3, 2, 4]), [true; 4]);
        bench.wait(150);
        assert_eq!(bench.asked(), []);
        bench.ledger.close();
        assert_eq!(bench.figures(), (0, 0));
    }

    #[test]
    fn a_message_that_was_recalled_before_it_came_is_taken_once() {
        let mut bench = Bench::new();
        bench.live([1]);
        assert!(bench.take(2, Origin::Recalled) && bench.take(4, Origin::Recalled));
        assert_eq!(bench.live([2, 3, 4, 5]), [false, true, false, true]);
        bench.ledger.close();
        assert_eq!(bench.figures(), (2, 0));
    }

    #[test]
    fn what_a_publisher_said_before_it_was_heard_is_asked_for_without_claim() {
        let mut bench = Bench::new();
        bench.live([11]);
        bench.wait(150);
        let question = bench.ledger.question(None, bench.now).unwrap();
        assert_eq!(question.others_since_ns, i64::MAX);
        let span = question.spans[0];
        assert_eq!((span.from, span.to, span.since_ns), (1, 10, 100));
        bench.take(10, Origin::Recalled);
        bench.ledger.close();
        assert_eq!(bench.figures(), (1, 0));
    }

    #[test]
    fn a_restart_goes_on_where_the_former_file_ends() {
        for (base, short) in [(0, 1000), (7 << 32, 1000), (5 << 32, u32::MAX - 1)] {
            let mut bench = Bench::new();
            let key = Arc::clone(&bench.key);
            let former = [short - 3, short - 2, short];
            bench.ledger.seed(&key, A, former, true, bench.now);
            let last = base + u64::from(short);
            bench.live([last + 5]);
            bench.wait(150);
            assert_eq!(bench.asked(), [(last - 1, last - 1), (last + 1, last + 4)]);
            for sequence in last - 4..last + 8 {
                let new = sequence == last - 1 || sequence > last && sequence != last + 5;
                assert_eq!(bench.take(sequence, Origin::Recalled), new, "{sequence}");
            }
            bench.ledger.close();
            assert_eq!(bench.figures(), (7, 0));
        }
    }

    #[test]
    fn everything_after_what_is_recorded_is_asked_for_at_once() {
        let mut bench = Bench::new();
        bench.live([1, 2, 3]);
        let question = bench.ledger.question(Some(7), bench.now).unwrap();
        assert_eq!(question.others_since_ns, 7);
        assert_eq!(
            (question.spans[0].from, question.spans[0].to),
            (4, u64::MAX)
        );
    }

    #[test]
    fn what_the_queue_pushed_out_is_missing_until_it_is_recovered() {
        let mut bench = Bench::new();
        let key = Arc::clone(&bench.key);
        bench.ledger.pushed_out(&key, A, 1, 90, bench.now);
        bench.live(91..=100);
        bench.wait(150);
        assert_eq!(bench.asked(), [(1, 90)]);
        bench.take(7, Origin::Recalled);
        // What lies between two that are recorded was seen already.
        bench.live([105]);
        bench.ledger.pushed_out(&key, A, 101, 104, bench.now);
        bench.ledger.close();
        assert_eq!(bench.figures(), (1, 93));
        // What was said before that, nobody claims.
        let mut bench = Bench::new();
        bench.live([1000]);
        bench.ledger.pushed_out(&key, A, 990, 999, bench.now);
        bench.ledger.close();
        assert_eq!(bench.figures(), (0, 10));
    }

    #[test]
    fn hostile_publishers_cost_bounded_memory() {
        let mut bench = Bench::new();
        for id in 0..2 * LINES_MAX as u32 {
            let mut publisher = [0; 16];
            publisher[..4].copy_from_slice(&id.to_le_bytes());
            let entry = Entry {
                key: &bench.key,
                publisher,
                sequence: 1 << 62,
                origin: Origin::Live,
            };
            assert!(bench.ledger.take(entry, bench.now));
        }
        assert_eq!(bench.ledger.lines.len(), LINES_MAX);
        bench.live((0..3000).map(|i| 1 + 2 * i));
        let line = &bench.ledger.lines[&(Arc::clone(&bench.key), A)];
        assert_eq!(line.gaps.len(), GAPS_MAX);
        bench.live([(1 << 63) - 1, 4]);
        bench.ledger.close();
    }
}
