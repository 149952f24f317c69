use super::line::GAPS_MAX;
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
fn missing_messages_are_requested_and_recorded_once() {
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
fn messages_that_no_publisher_has_stay_missing() {
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
fn at_the_end_everything_behind_the_last_message_is_requested_too() {
    let mut bench = Bench::new();
    assert!(bench.ledger.last_question(bench.now).is_none());
    bench.live([1, 2, 4]);
    let question = bench.ledger.last_question(bench.now).unwrap();
    assert_eq!(question.others_since_ns, i64::MAX);
    let spans = question.spans.iter().map(|s| (s.from, s.to));
    assert_eq!(spans.collect::<Vec<_>>(), [(3, 3), (5, u64::MAX)]);
    assert!(bench.take(3, Origin::Recalled) && bench.take(5, Origin::Recalled));
    bench.ledger.close();
    assert_eq!(bench.figures(), (2, 0));
}

#[test]
fn late_messages_are_neither_missing_nor_recovered() {
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
fn messages_before_the_first_received_one_are_requested_but_not_missing() {
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
fn messages_dropped_from_the_queue_are_missing_until_they_are_recovered() {
    let mut bench = Bench::new();
    let key = Arc::clone(&bench.key);
    bench.ledger.pushed_out(&key, A, 1, 90, bench.now);
    bench.live(91..=100);
    bench.wait(150);
    assert_eq!(bench.asked(), [(1, 90)]);
    bench.take(7, Origin::Recalled);
    // Messages between two recorded ones were already received.
    bench.live([105]);
    bench.ledger.pushed_out(&key, A, 101, 104, bench.now);
    bench.ledger.close();
    assert_eq!(bench.figures(), (1, 93));
    // Messages before that do not count as missing.
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
