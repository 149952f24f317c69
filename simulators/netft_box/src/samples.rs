//! Samples of the plant that wait for their time.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Most samples that wait for their time: 0.4 s at 7 kHz.
const SAMPLES_MAX: usize = 2800;

/// One reading of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoxSample {
    /// Fx, Fy, Fz, Tx, Ty, Tz in counts.
    pub counts: [i32; 6],
    /// A gauge is saturated.
    pub saturated: bool,
}

/// Longest wait for a sample whose time has come, since a plant computes a period shortly after it
/// began. Without the wait, all records of this short time would repeat one sample, and its noise
/// would have the weight of all of them.
const SAMPLE_PATIENCE: Duration = Duration::from_millis(10);

/// Samples that wait for their time.
#[derive(Debug, Default)]
pub(crate) struct SampleQueue {
    waiting: VecDeque<(Instant, BoxSample)>,
    now: BoxSample,
    /// End of the last sample's time; `None` if a reading is held without end.
    known_until: Option<Instant>,
}

impl SampleQueue {
    pub(crate) fn push(&mut self, first: Instant, interval: Duration, samples: &[BoxSample]) {
        let mut time = first;
        for sample in samples {
            if self.waiting.len() == SAMPLES_MAX {
                self.waiting.pop_front();
            }
            self.waiting.push_back((time, *sample));
            time += interval;
        }
        self.known_until = Some(time);
    }

    pub(crate) fn hold(&mut self, sample: BoxSample) {
        self.waiting.clear();
        self.now = sample;
        self.known_until = None;
    }

    /// The reading at `time`, which is in the past at `now`; `None` while it may still arrive.
    pub(crate) fn at(&mut self, time: Instant, now: Instant) -> Option<BoxSample> {
        let unknown = self.known_until.is_some_and(|until| time >= until);
        if unknown && now.saturating_duration_since(time) < SAMPLE_PATIENCE {
            return None;
        }
        while let Some((start, sample)) = self.waiting.front()
            && *start <= time
        {
            self.now = *sample;
            self.waiting.pop_front();
        }
        Some(self.now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(x: i32) -> BoxSample {
        BoxSample {
            counts: [x; 6],
            saturated: false,
        }
    }

    #[test]
    fn samples_are_read_at_their_time_and_the_last_stays() {
        let start = Instant::now();
        let ms = Duration::from_millis;
        let mut queue = SampleQueue::default();
        let read = |queue: &mut SampleQueue, at: u64, now: u64| {
            queue
                .at(start + ms(at), start + ms(now))
                .map(|s| s.counts[0])
        };
        assert_eq!(read(&mut queue, 0, 0), Some(0), "never fed");
        queue.push(start, ms(1), &[sample(1), sample(2), sample(3)]);
        assert_eq!(read(&mut queue, 0, 0), Some(1));
        assert_eq!(read(&mut queue, 1, 1), Some(2));
        assert_eq!(read(&mut queue, 2, 2), Some(3));
        assert_eq!(read(&mut queue, 3, 3), None, "may still come");
        assert_eq!(read(&mut queue, 3, 12), None);
        assert_eq!(read(&mut queue, 3, 13), Some(3), "does not come");
        queue.push(start + ms(1), ms(1), &[sample(4), sample(5)]);
        assert_eq!(read(&mut queue, 4, 20), Some(5), "the past is skipped");
        queue.hold(sample(6));
        assert_eq!(read(&mut queue, 90, 90), Some(6));
    }

    #[test]
    fn a_plant_that_computes_its_period_late_has_every_sample_read_once() {
        // As in the cell: samples of a period of 8 ms, known 2.3 ms after it began; the box polls
        // every 0.2 ms.
        let us = Duration::from_micros;
        let (start, interval) = (Instant::now(), us(125));
        let mut queue = SampleQueue::default();
        queue.push(start, interval, &[sample(0)]);
        let (mut due, mut read) = (start, Vec::new());
        let mut pushed = 0;
        for look in 0..400 {
            let now = start + us(200) * look;
            if now >= start + us(2300) + us(8000) * pushed {
                let first = 1 + 64 * pushed as i32;
                let samples: Vec<_> = (first..first + 64).map(sample).collect();
                queue.push(start + us(8000) * pushed + interval, interval, &samples);
                pushed += 1;
            }
            while due <= now
                && let Some(sample) = queue.at(due, now)
            {
                read.push(sample.counts[0]);
                due += interval;
            }
        }
        assert!(read.len() > 600, "{} read", read.len());
        let all: Vec<i32> = (0..read.len() as i32).collect();
        assert_eq!(read, all);
    }
}
