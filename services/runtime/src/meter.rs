//! Lock-free figures that a real-time thread writes and the health reporter reads.

use std::array;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Counts events; the reporter turns it into a rate in Hz.
#[derive(Clone, Debug, Default)]
pub struct Rate(Arc<AtomicU64>);

impl Rate {
    /// Counts one more event.
    pub fn tick(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of events so far.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A count that only grows: losses, refusals.
#[derive(Clone, Debug, Default)]
pub struct Counter(Arc<AtomicU64>);

impl Counter {
    /// Adds `more` to the total.
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// Sets the total, if it is counted elsewhere.
    pub fn set(&self, total: u64) {
        self.0.store(total, Ordering::Relaxed);
    }

    /// The total.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A number that is set, of which only the last value counts.
#[derive(Clone, Debug, Default)]
pub struct Gauge(Arc<AtomicU64>);

impl Gauge {
    /// Sets the value.
    pub fn set(&self, value: f64) {
        self.0.store(value.to_bits(), Ordering::Relaxed);
    }

    /// The last value; 0 at first.
    pub fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }
}

/// Time since the last event.
#[derive(Clone, Debug)]
pub struct Age {
    start: Instant,
    last_ns: Arc<AtomicI64>,
}

impl Default for Age {
    fn default() -> Self {
        Self {
            start: Instant::now(),
            last_ns: Arc::new(AtomicI64::new(-1)),
        }
    }
}

impl Age {
    /// Records an event now.
    pub fn mark(&self) {
        self.mark_at(Instant::now());
    }

    /// Records an event at `instant`.
    pub fn mark_at(&self, instant: Instant) {
        let ns = instant.saturating_duration_since(self.start).as_nanos();
        self.last_ns
            .store(i64::try_from(ns).unwrap_or(i64::MAX), Ordering::Relaxed);
    }

    /// Time since the last event, s; negative before the first.
    pub fn seconds(&self) -> f64 {
        match self.last_ns.load(Ordering::Relaxed) {
            last if last < 0 => -1.0,
            last => (self.start.elapsed().as_nanos() as f64 - last as f64).max(0.0) * 1e-9,
        }
    }
}

/// Sub-buckets per power of two: values are resolved to 1/32, about 3 %.
const SUB: usize = 32;
const BUCKETS: usize = 35 * SUB;

/// A distribution of durations, from 1 ns to over half a minute, with a resolution of 3 %.
#[derive(Clone, Debug)]
pub struct Histogram(Arc<Buckets>);

#[derive(Debug)]
struct Buckets {
    counts: [AtomicU64; BUCKETS],
    max_ns: AtomicU64,
}

/// Figures of a [`Histogram`], s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distribution {
    /// Number of durations.
    pub n: u64,
    /// Half are at most this, s.
    pub p50_s: f64,
    /// 99 % are at most this, s.
    pub p99_s: f64,
    /// 99.9 % are at most this, s.
    pub p999_s: f64,
    /// The longest, exact, s.
    pub max_s: f64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self(Arc::new(Buckets {
            counts: array::from_fn(|_| AtomicU64::new(0)),
            max_ns: AtomicU64::new(0),
        }))
    }
}

impl Histogram {
    /// Adds one duration. Takes no lock and allocates nothing.
    pub fn record(&self, duration: Duration) {
        let ns = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        self.0.counts[bucket(ns)].fetch_add(1, Ordering::Relaxed);
        self.0.max_ns.fetch_max(ns, Ordering::Relaxed);
    }

    /// Adds a time in seconds that came from outside. NaN and negative values count as zero, values
    /// too large for a `Duration` as the longest.
    pub fn record_s(&self, seconds: f64) {
        let known = seconds.max(0.0);
        self.record(Duration::try_from_secs_f64(known).unwrap_or(Duration::MAX));
    }

    /// The distribution of all durations since the start.
    pub fn distribution(&self) -> Distribution {
        let counts: Vec<u64> = self
            .0
            .counts
            .iter()
            .map(|count| count.load(Ordering::Relaxed))
            .collect();
        let n: u64 = counts.iter().sum();
        let max_ns = self.0.max_ns.load(Ordering::Relaxed);
        let quantile = |q: f64| {
            let rank = ((n as f64 * q).ceil() as u64).max(1);
            let mut seen = 0;
            for (index, count) in counts.iter().enumerate() {
                seen += count;
                if seen >= rank {
                    return upper_edge_ns(index).min(max_ns) as f64 * 1e-9;
                }
            }
            0.0
        };
        Distribution {
            n,
            p50_s: quantile(0.5),
            p99_s: quantile(0.99),
            p999_s: quantile(0.999),
            max_s: max_ns as f64 * 1e-9,
        }
    }
}

/// Values below 32 have a bucket each, then 32 buckets for every power of two.
fn bucket(ns: u64) -> usize {
    if ns < SUB as u64 {
        return ns as usize;
    }
    let power = ns.ilog2() as usize - SUB.ilog2() as usize;
    let sub = (ns >> power) as usize - SUB;
    ((power + 1) * SUB + sub).min(BUCKETS - 1)
}

fn upper_edge_ns(index: usize) -> u64 {
    if index < SUB {
        return index as u64;
    }
    if index == BUCKETS - 1 {
        return u64::MAX;
    }
    let power = index / SUB - 1;
    (((SUB + index % SUB + 1) as u64) << power) - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_duration_falls_into_the_bucket_whose_edges_hold_it() {
        let mut ns = 0;
        while ns < 60_000_000_000 {
            let index = bucket(ns);
            assert!(ns <= upper_edge_ns(index), "{ns}");
            assert!(index == 0 || ns > upper_edge_ns(index - 1), "{ns}");
            ns += 1 + ns / 40;
        }
    }

    #[test]
    fn quantiles_are_right_to_3_percent() {
        let histogram = Histogram::default();
        for us in 1..=1000 {
            histogram.record(Duration::from_micros(us));
        }
        let found = histogram.distribution();
        assert_eq!(found.n, 1000);
        assert_eq!(found.max_s, 1e-3);
        for (value, exact) in [
            (found.p50_s, 500e-6),
            (found.p99_s, 990e-6),
            (found.p999_s, 999e-6),
        ] {
            assert!((value / exact - 1.0).abs() < 1.0 / 32.0, "{value} {exact}");
        }
        assert_eq!(Histogram::default().distribution(), Distribution::default());
    }

    #[test]
    fn an_age_is_negative_until_the_first_mark() {
        let age = Age::default();
        assert_eq!(age.seconds(), -1.0);
        age.mark();
        assert!(age.seconds() >= 0.0);
    }
}
