//! State of the stream, without its socket: which request to send and when, and the kind of each
//! record.

use std::time::Duration;

use crate::codec::{Command, FT_RATE_HZ, Record, Request};

/// Longest pause between two requests while the box is silent.
const PAUSE_MAX: Duration = Duration::from_secs(1);
/// A record whose count is at most this far back can be late, if its place in the stream fits.
/// Further back, the box has restarted.
const LATE_MAX: i64 = 7000;
/// Largest lead of the count over elapsed time that clocks and queueing explain, s.
const AHEAD_MAX_S: f64 = 1.0;
/// Number of records remembered, to tell a late one from a duplicate.
const REMEMBERED: usize = 256;

/// Kind of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Newer than all earlier ones.
    Next {
        /// Records lost between the previous one and this one, including those during a pause of
        /// the stream.
        missed: u32,
    },
    /// Overtaken by a newer one; it is recorded but not filtered.
    Late,
    /// A duplicate.
    Double,
    /// First of a stream, or first after the box restarted its count: clock, filter and counts are
    /// reset.
    First,
}

/// Counts since the service started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamCounts {
    /// Records received, without duplicates.
    pub records: u64,
    /// Records sent but never received.
    pub lost: u64,
    /// Records that arrived after a newer one.
    pub out_of_order: u64,
    /// Duplicate records.
    pub doubles: u64,
    /// Number of times that the box restarted its count.
    pub restarts: u64,
    /// Number of times that the stream returned after silence.
    pub reconnects: u64,
    /// Datagrams that are not valid.
    pub malformed: u64,
    /// Requests sent.
    pub requests: u64,
}

/// State of one stream. Times are durations on any monotonic clock.
#[derive(Clone, Debug)]
pub struct Stream {
    request: Request,
    patience: Duration,
    step: i64,
    counts: StreamCounts,
    last: Option<Last>,
    seen: [i64; REMEMBERED],
    asked: Option<Duration>,
    heard: Option<Duration>,
    pause: Duration,
    silent: bool,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    /// Does not wrap around.
    sequence: i64,
    rdt_sequence: u32,
    at: Duration,
}

impl Stream {
    /// Requests records with `command` (real-time or buffered) without end at `rate_hz`, and again
    /// after each silence of `patience`.
    pub fn new(command: Command, rate_hz: f64, patience: Duration) -> Self {
        Self {
            request: Request {
                command,
                sample_count: 0,
            },
            patience,
            step: (FT_RATE_HZ / rate_hz).round().max(1.0) as i64,
            counts: StreamCounts::default(),
            last: None,
            seen: [i64::MIN; REMEMBERED],
            asked: None,
            heard: None,
            pause: patience,
            silent: true,
        }
    }

    /// Continues the counts of a stream before this one.
    pub fn with_counts(mut self, counts: StreamCounts) -> Self {
        self.counts = counts;
        self
    }

    /// The request to send now, if one is due. During silence the pauses between requests double up
    /// to 1 s, and requests continue without limit.
    pub fn poll(&mut self, now: Duration) -> Option<Request> {
        if let Some(heard) = self.heard
            && now.saturating_sub(heard) < self.patience
        {
            return None;
        }
        if self.heard.is_some() {
            self.silent = true;
        }
        let due = match self.asked {
            None => true,
            Some(asked) => now.saturating_sub(asked) >= self.pause,
        };
        if !due {
            return None;
        }
        if self.asked.is_some() && self.silent {
            self.pause = (self.pause * 2).min(PAUSE_MAX);
        }
        self.asked = Some(now);
        self.counts.requests += 1;
        Some(self.request)
    }

    /// Takes one record that arrived at `now`; returns its kind and its sequence number on the
    /// box's clock, which does not wrap around.
    pub fn take(&mut self, record: &Record, now: Duration) -> (i64, Kind) {
        // Also counts a change of connection, which keeps the counts.
        if self.silent && self.counts.records > 0 {
            self.counts.reconnects += 1;
        }
        self.silent = false;
        self.heard = Some(now);
        self.pause = self.patience;
        let Some(last) = self.last else {
            return self.begin(record, now);
        };
        let ahead = i64::from(record.ft_sequence.wrapping_sub(last.sequence as u32) as i32);
        let sequence = last.sequence + ahead;
        if self.is_late(&last, record, ahead) {
            return (sequence, self.late(sequence));
        }
        let elapsed = now.saturating_sub(last.at).as_secs_f64();
        if ahead < 0 || ahead as f64 > (elapsed + AHEAD_MAX_S) * FT_RATE_HZ {
            self.counts.restarts += 1;
            return self.begin(record, now);
        }
        let sent = record.rdt_sequence.wrapping_sub(last.rdt_sequence);
        // A new request counts from 1 again; records that were not sent are not lost.
        if record.rdt_sequence > last.rdt_sequence && i64::from(sent) <= ahead {
            self.counts.lost += u64::from(sent) - 1;
            self.step = (ahead / i64::from(sent)).max(1);
        }
        let missed = u32::try_from((ahead / self.step - 1).max(0)).unwrap_or(u32::MAX);
        self.enter(sequence, record, now);
        (sequence, Kind::Next { missed })
    }

    /// Counts a datagram that is not valid.
    pub fn malformed(&mut self) {
        self.counts.malformed += 1;
    }

    /// Whether the record is an earlier one of this count, not one of a restarted box: it arrived
    /// late, or its two counts are equally far back.
    fn is_late(&self, last: &Last, record: &Record, ahead: i64) -> bool {
        let back = i64::from(last.rdt_sequence.wrapping_sub(record.rdt_sequence) as i32);
        let lately = ahead > -(REMEMBERED as i64) * self.step;
        ahead <= 0 && (lately || (ahead >= -LATE_MAX && back * self.step == -ahead))
    }

    fn begin(&mut self, record: &Record, now: Duration) -> (i64, Kind) {
        let sequence = i64::from(record.ft_sequence);
        self.seen = [i64::MIN; REMEMBERED];
        self.enter(sequence, record, now);
        (sequence, Kind::First)
    }

    fn enter(&mut self, sequence: i64, record: &Record, now: Duration) {
        self.counts.records += 1;
        self.last = Some(Last {
            sequence,
            rdt_sequence: record.rdt_sequence,
            at: now,
        });
        self.remember(sequence);
    }

    fn late(&mut self, sequence: i64) -> Kind {
        if self.seen[self.slot(sequence)] == sequence {
            self.counts.doubles += 1;
            return Kind::Double;
        }
        self.remember(sequence);
        self.counts.records += 1;
        self.counts.out_of_order += 1;
        // It was counted as lost when a newer one arrived. One from before all remembered records
        // may be a duplicate.
        if self.is_remembered(sequence) {
            self.counts.lost = self.counts.lost.saturating_sub(1);
        }
        Kind::Late
    }

    fn is_remembered(&self, sequence: i64) -> bool {
        self.last
            .is_some_and(|last| last.sequence - sequence < REMEMBERED as i64 * self.step)
    }

    fn slot(&self, sequence: i64) -> usize {
        (sequence / self.step).rem_euclid(REMEMBERED as i64) as usize
    }

    fn remember(&mut self, sequence: i64) {
        let slot = self.slot(sequence);
        self.seen[slot] = sequence;
    }

    /// Time since the last record; `None` before the first.
    pub fn silence(&self, now: Duration) -> Option<Duration> {
        self.heard.map(|heard| now.saturating_sub(heard))
    }

    /// Whether no record arrived for longer than the patience.
    pub fn is_silent(&self, now: Duration) -> bool {
        self.silence(now)
            .is_none_or(|silence| silence >= self.patience)
    }

    /// Counts since the service started.
    pub fn counts(&self) -> &StreamCounts {
        &self.counts
    }

    /// Increment of the box's clock between two records.
    pub fn step(&self) -> i64 {
        self.step
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PATIENCE: Duration = Duration::from_millis(50);

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn stream() -> Stream {
        Stream::new(Command::RealTime, 7000.0, PATIENCE)
    }

    fn record(rdt: u32, ft: u32) -> Record {
        Record {
            rdt_sequence: rdt,
            ft_sequence: ft,
            ..Record::default()
        }
    }

    fn kinds(stream: &mut Stream, records: &[(u32, u32)]) -> Vec<Kind> {
        records
            .iter()
            .map(|(rdt, ft)| stream.take(&record(*rdt, *ft), ms(1)).1)
            .collect()
    }

    const NEXT: Kind = Kind::Next { missed: 0 };

    #[test]
    fn gaps_duplicates_and_late_records_are_distinguished() {
        let mut stream = stream();
        let kinds = kinds(
            &mut stream,
            &[
                (1, 100),
                (2, 101),
                (5, 104),
                (4, 103),
                (5, 104),
                (2, 101),
                (6, 105),
            ],
        );
        let missed = Kind::Next { missed: 2 };
        assert_eq!(
            kinds,
            [
                Kind::First,
                NEXT,
                missed,
                Kind::Late,
                Kind::Double,
                Kind::Double,
                NEXT
            ]
        );
        let counts = stream.counts();
        assert_eq!((counts.records, counts.lost), (5, 1));
        assert_eq!((counts.out_of_order, counts.doubles), (1, 2));
    }

    #[test]
    fn sequences_wrap_around() {
        let mut stream = stream();
        let (before, _) = stream.take(&record(1, u32::MAX), ms(0));
        let (after, kind) = stream.take(&record(2, 0), ms(1));
        assert_eq!((after - before, kind), (1, NEXT));
    }

    #[test]
    fn a_box_that_counts_anew_is_noticed_and_a_pause_is_not_a_restart() {
        let mut stream = stream();
        stream.take(&record(70_000, 500_000), ms(0));
        assert_eq!(stream.take(&record(1, 12), ms(3)).1, Kind::First);
        assert_eq!(stream.counts().restarts, 1);
        // Ten seconds of silence, then the count is where it should be, under a new request.
        let kind = stream.take(&record(1, 12 + 70_000), ms(10_003)).1;
        assert_eq!(kind, Kind::Next { missed: 69_999 });
        assert_eq!((stream.counts().restarts, stream.counts().lost), (1, 0));
        // Ahead of all time: another box, or garbage.
        assert_eq!(
            stream.take(&record(2, 3_000_000), ms(10_004)).1,
            Kind::First
        );
        assert_eq!(stream.counts().restarts, 2);
    }

    #[test]
    fn a_box_that_restarts_soon_after_its_start_is_noticed() {
        let mut stream = stream();
        stream.take(&record(4000, 5000), ms(0));
        assert_eq!(stream.take(&record(3000, 4000), ms(1)).1, Kind::Late);
        assert_eq!(stream.take(&record(1, 700), ms(100)).1, Kind::First);
        assert_eq!(stream.counts().restarts, 1);
    }

    #[test]
    fn at_lower_rates_the_count_goes_in_steps() {
        let mut stream = Stream::new(Command::RealTime, 1000.0, PATIENCE);
        let kinds = kinds(&mut stream, &[(1, 7), (2, 14), (4, 28), (3, 21)]);
        let missed = Kind::Next { missed: 1 };
        assert_eq!(kinds, [Kind::First, NEXT, missed, Kind::Late]);
        assert_eq!(stream.counts().lost, 0);
    }

    #[test]
    fn silence_is_met_with_requests_that_grow_rarer_and_never_end() {
        let mut stream = stream();
        assert!(stream.poll(ms(0)).is_some());
        stream.take(&record(1, 1), ms(2));
        assert_eq!(stream.poll(ms(51)), None);
        assert!(stream.poll(ms(52)).is_some());
        let mut times = Vec::new();
        for t in 53..20_000 {
            if stream.poll(ms(t)).is_some() {
                times.push(t);
            }
        }
        let gaps: Vec<_> = times.windows(2).map(|w| w[1] - w[0]).collect();
        assert_eq!(&gaps[..5], [200, 400, 800, 1000, 1000]);
        assert_eq!(gaps.last(), Some(&1000));
        // The stream returns, and the timeout is short again.
        stream.take(&record(1, 140_000), ms(20_000));
        assert_eq!(stream.counts().reconnects, 1);
        assert!(!stream.is_silent(ms(20_049)));
        assert!(stream.poll(ms(20_050)).is_some());
    }

    proptest! {
        #[test]
        fn no_records_whatever_break_the_books(records in prop::collection::vec((any::<u32>(), any::<u32>(), 0u64..100), 1..200)) {
            let mut stream = stream();
            let mut now = Duration::ZERO;
            for (rdt, ft, pause) in &records {
                now += ms(*pause);
                stream.poll(now);
                stream.take(&record(*rdt, *ft), now);
            }
            let counts = stream.counts();
            prop_assert_eq!(counts.records + counts.doubles, records.len() as u64);
        }

        #[test]
        fn any_shuffle_within_a_window_loses_nothing(order in Just((1u32..=60).collect::<Vec<_>>()).prop_shuffle()) {
            let mut stream = stream();
            stream.take(&record(0, 999), ms(0));
            for i in order {
                stream.take(&record(i, 999 + i), ms(1));
            }
            prop_assert_eq!(stream.counts().lost, 0);
            prop_assert_eq!(stream.counts().records, 61);
        }
    }
}
