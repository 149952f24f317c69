//! Rate of a topic: intervals between arrivals, age, and losses by sequence number.

use std::collections::HashMap;
use std::time::Instant;

use serde::Serialize;
use tangent_runtime::bus::RawMessage;

/// Measures one topic, message by message.
#[derive(Debug, Default)]
pub struct RateMeter {
    last: Option<Instant>,
    intervals_s: Vec<f64>,
    sequences: HashMap<[u8; 16], u64>,
    messages: u64,
    lost: u64,
    bytes: u64,
}

/// Rate of a topic over the time of the measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rate {
    /// Number of messages.
    pub messages: u64,
    /// Mean rate; null with fewer than two messages.
    pub rate_hz: Option<f64>,
    /// Shortest interval between two arrivals, ms.
    pub interval_min_ms: Option<f64>,
    /// Median interval, ms.
    pub interval_median_ms: Option<f64>,
    /// 99th percentile of the intervals, ms.
    pub interval_p99_ms: Option<f64>,
    /// Longest interval, ms.
    pub interval_max_ms: Option<f64>,
    /// Messages missing by their sequence numbers.
    pub lost: u64,
    /// Mean size of a message, bytes.
    pub bytes_mean: Option<f64>,
}

impl RateMeter {
    /// Takes the next message.
    pub fn take(&mut self, message: &RawMessage) {
        self.messages += 1;
        self.bytes += message.payload.len() as u64;
        if let Some(last) = self.last.replace(message.received) {
            let interval = message.received.saturating_duration_since(last);
            self.intervals_s.push(interval.as_secs_f64());
        }
        if message.sequence > 0 {
            let before = self.sequences.insert(message.publisher, message.sequence);
            let missing = before.map(|before| message.sequence.saturating_sub(before + 1));
            self.lost += missing.unwrap_or(0);
        }
    }

    /// The rate of everything taken so far.
    pub fn rate(&self) -> Rate {
        let mut sorted = self.intervals_s.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let last = sorted.len().checked_sub(1)?;
            Some(1e3 * sorted[(last as f64 * share).round() as usize])
        };
        let total: f64 = sorted.iter().sum();
        Rate {
            messages: self.messages,
            rate_hz: (total > 0.0).then(|| sorted.len() as f64 / total),
            interval_min_ms: at(0.0),
            interval_median_ms: at(0.5),
            interval_p99_ms: at(0.99),
            interval_max_ms: at(1.0),
            lost: self.lost,
            bytes_mean: (self.messages > 0).then(|| self.bytes as f64 / self.messages as f64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn intervals_and_losses_are_counted() {
        let start = Instant::now();
        let mut meter = RateMeter::default();
        assert_eq!(meter.rate().rate_hz, None);
        for (at_ms, sequence) in [(0, 1), (10, 2), (20, 3), (40, 6)] {
            meter.take(&RawMessage {
                key: "x".into(),
                type_name: "".into(),
                payload: [0; 8][..].into(),
                sequence,
                source_time_ns: 0,
                publisher: [7; 16],
                received: start + Duration::from_millis(at_ms),
                received_ns: 0,
            });
        }
        let rate = meter.rate();
        assert_eq!((rate.messages, rate.lost), (4, 2));
        assert!((rate.rate_hz.unwrap() - 75.0).abs() < 1e-9);
        assert_eq!(rate.interval_max_ms.map(f64::round), Some(20.0));
        assert_eq!(rate.bytes_mean, Some(8.0));
    }
}
