//! Recovery of the sensor's clock on this host: a line under the arrival times of its sequence
//! numbers.
//!
//! No record arrives before it was sent, so the earliest arrivals show the time, and the delay of
//! all others is queueing. The line is below every arrival of a window and as close to them as
//! possible: it is the edge of their lower convex hull at the window's middle. Called by the
//! receiving thread; it reads no clock itself.

/// Number of points kept: the earliest arrival of each slice.
const SLICES: usize = 64;
/// Length of a slice, s; the window is 64 of them, 4 s.
const SLICE_S: f64 = 0.0625;
/// Largest accepted relative deviation of the sensor's rate from its nominal rate; crystals are
/// accurate to 0.0001.
const RATE_TOLERANCE: f64 = 0.002;
/// An arrival earlier than predicted by more than this, s, means that the sensor's count has
/// jumped.
const EARLY_S: f64 = 0.02;

/// An earliest arrival: sequence relative to the anchor, and lateness against the nominal line, s.
#[derive(Clone, Copy, Debug, Default)]
struct Point {
    sequence: f64,
    lateness: f64,
}

/// Converts sequence numbers to times of measurement.
#[derive(Clone, Debug)]
pub struct ClockRecovery {
    period_s: f64,
    /// Sequence number and arrival (ns) to which all other values are relative.
    anchor: Option<(i64, i64)>,
    points: [Point; SLICES],
    /// Points in use, oldest first from `first`.
    first: usize,
    count: usize,
    slice: Option<(i64, Point)>,
    /// The present line: lateness = offset + slope * sequence.
    offset: f64,
    slope: f64,
    residual_s: f64,
}

impl ClockRecovery {
    /// `period_s` is the nominal time between two counts.
    pub fn new(period_s: f64) -> Self {
        Self {
            period_s,
            anchor: None,
            points: [Point::default(); SLICES],
            first: 0,
            count: 0,
            slice: None,
            offset: 0.0,
            slope: 0.0,
            residual_s: 0.0,
        }
    }

    /// Discards all state, as the sensor's count has started again.
    pub fn restart(&mut self) {
        *self = Self::new(self.period_s);
    }

    /// Adds the arrival of `sequence` (which does not wrap around) at `arrival_ns` on this host's
    /// monotonic clock, and returns the time of its measurement on the same clock, which is never
    /// after its arrival. Allocates nothing.
    pub fn observe(&mut self, sequence: i64, arrival_ns: i64) -> i64 {
        let (sequence_0, arrival_0) = *self.anchor.get_or_insert((sequence, arrival_ns));
        let n = (sequence - sequence_0) as f64;
        let elapsed = (arrival_ns - arrival_0) as f64 * 1e-9;
        let point = Point {
            sequence: n,
            lateness: elapsed - n * self.period_s,
        };
        if point.lateness < self.line(n) - EARLY_S {
            self.restart();
            return self.observe(sequence, arrival_ns);
        }
        self.enter(point);
        self.stamp(sequence, arrival_ns)
    }

    /// Time of measurement of `sequence`, for a record whose arrival must not be used: not the last
    /// of its datagram, or overtaken.
    pub fn stamp(&self, sequence: i64, arrival_ns: i64) -> i64 {
        let Some((sequence_0, arrival_0)) = self.anchor else {
            return arrival_ns;
        };
        let n = (sequence - sequence_0) as f64;
        let line_s = n * self.period_s + self.line(n);
        arrival_ns.min(arrival_0 + (line_s * 1e9) as i64)
    }

    fn line(&self, n: f64) -> f64 {
        self.offset + self.slope * n
    }

    /// Adds an arrival to its slice, and closes slices that are over.
    fn enter(&mut self, point: Point) {
        let index = (point.sequence * self.period_s / SLICE_S).floor() as i64;
        match &mut self.slice {
            Some((open, earliest)) if *open == index => {
                if point.lateness < earliest.lateness {
                    *earliest = point;
                }
            }
            Some((open, _)) if *open > index => {} // Out of order: its slice is closed.
            _ => {
                if let Some((_, earliest)) = self.slice.replace((index, point)) {
                    self.push(earliest);
                    self.fit();
                }
            }
        }
        if self.count < 2 {
            // Without a slope yet, the line has the nominal rate and passes through the earliest
            // arrival so far.
            self.offset = self.earliest().min(point.lateness);
            self.slope = 0.0;
        }
    }

    fn earliest(&self) -> f64 {
        self.iter()
            .chain(self.slice.map(|(_, point)| point))
            .map(|point| point.lateness)
            .fold(f64::INFINITY, f64::min)
    }

    fn push(&mut self, point: Point) {
        if self.count == SLICES {
            self.first = (self.first + 1) % SLICES;
            self.count -= 1;
        }
        self.points[(self.first + self.count) % SLICES] = point;
        self.count += 1;
    }

    fn iter(&self) -> impl Iterator<Item = Point> + '_ {
        (0..self.count).map(|i| self.points[(self.first + i) % SLICES])
    }

    /// Fits the edge of the lower hull over the window's middle. Of all lines under the points, it
    /// has the smallest sum of distances to them.
    fn fit(&mut self) {
        if self.count < 2 {
            return;
        }
        let mut hull = [Point::default(); SLICES];
        let mut size = 0;
        for point in self.iter() {
            while size >= 2 && !turns_up(hull[size - 2], hull[size - 1], point) {
                size -= 1;
            }
            hull[size] = point;
            size += 1;
        }
        let middle = self.iter().map(|point| point.sequence).sum::<f64>() / self.count as f64;
        let edge = hull[..size]
            .windows(2)
            .find(|edge| edge[1].sequence >= middle)
            .map(|edge| (edge[0], edge[1]));
        let Some((a, b)) = edge else { return };
        let slope = (b.lateness - a.lateness) / (b.sequence - a.sequence);
        if slope.abs() <= RATE_TOLERANCE * self.period_s {
            self.slope = slope;
            self.offset = a.lateness - slope * a.sequence;
        } else {
            self.slope = 0.0;
            self.offset = self.earliest();
        }
        let square: f64 = self
            .iter()
            .map(|point| (point.lateness - self.line(point.sequence)).powi(2))
            .sum();
        self.residual_s = (square / self.count as f64).sqrt();
    }

    /// Rms distance of the earliest arrivals from the line, s: a measure of the accuracy of the
    /// stamps.
    pub fn residual_s(&self) -> f64 {
        self.residual_s
    }

    /// Rate of the sensor's count by this host's clock, Hz.
    pub fn rate_hz(&self) -> f64 {
        1.0 / (self.period_s + self.slope)
    }
}

/// Whether `c` lies above the line from `a` through `b`.
fn turns_up(a: Point, b: Point, c: Point) -> bool {
    (b.lateness - a.lateness) * (c.sequence - b.sequence)
        < (c.lateness - b.lateness) * (b.sequence - a.sequence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD: f64 = 1.0 / 7000.0;

    /// Deterministic noise in 0..1.
    fn noise(state: &mut u64) -> f64 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*state >> 33) as f64 / (1u64 << 31) as f64
    }

    /// Rms and largest error (s) of the stamps after the first second, against the sensor's truth
    /// plus its least delay.
    fn errors(seed: u64, ppm: f64, seconds: f64, delay: impl Fn(f64, f64) -> f64) -> (f64, f64) {
        let mut clock = ClockRecovery::new(PERIOD);
        let mut state = seed;
        let (mut square, mut worst, mut n) = (0.0, 0.0f64, 0.0);
        let mut last_arrival = 0;
        for i in 0..(7000.0 * seconds) as i64 {
            let truth = i as f64 * PERIOD * (1.0 + ppm * 1e-6);
            let arrival = ((truth + delay(truth, noise(&mut state))) * 1e9) as i64;
            last_arrival = arrival.max(last_arrival);
            let stamp = clock.observe(1_000_000 + i, last_arrival);
            assert!(stamp <= last_arrival);
            if truth > 1.0 {
                let error = stamp as f64 * 1e-9 - truth - 50e-6;
                square += error * error;
                worst = worst.max(error.abs());
                n += 1.0;
            }
        }
        assert!((clock.rate_hz() / 7000.0 * (1.0 + ppm * 1e-6) - 1.0).abs() < 1e-5);
        ((square / n).sqrt(), worst)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn stamps_are_right_to_20_us_rms_through_queueing(seed: u64, ppm in -100.0f64..100.0) {
            // 50 µs of wire; one record in three waits an exponential 500 µs, one in a hundred up
            // to 8 ms.
            let (rms, worst) = errors(seed, ppm, 8.0, |_, u| {
                let wait = match u {
                    u if u < 0.65 => u * 20e-6,
                    u if u < 0.99 => -500e-6 * ((u - 0.65) / 0.34).max(1e-6).ln(),
                    u => (u - 0.99) * 0.8,
                };
                50e-6 + wait
            });
            prop_assert!(rms < 20e-6, "{rms} s rms");
            prop_assert!(worst < 60e-6, "{worst} s at worst");
        }
    }

    #[test]
    fn a_stall_of_a_second_does_not_move_the_line() {
        let (rms, worst) = errors(7, 30.0, 8.0, |truth, u| {
            let stall = if (4.0..5.0).contains(&truth) {
                5.0 - truth
            } else {
                0.0
            };
            50e-6 + u * 10e-6 + stall
        });
        assert!(
            rms < 20e-6 && worst < 60e-6,
            "{rms} s rms, {worst} s at worst"
        );
    }

    #[test]
    fn a_count_that_jumps_ahead_begins_anew() {
        let mut clock = ClockRecovery::new(PERIOD);
        for i in 0..14_000 {
            clock.observe(i, (i as f64 * PERIOD * 1e9) as i64);
        }
        let arrival = 2_000_000_000;
        assert_eq!(clock.observe(5_000_000, arrival), arrival);
        let next = clock.observe(5_000_007, arrival + 1_000_000);
        assert!((next - arrival - 1_000_000).abs() < 1_000);
    }

    #[test]
    fn the_residual_is_that_of_the_earliest() {
        let mut clock = ClockRecovery::new(PERIOD);
        for i in 0..70_000i64 {
            // Earliest in time, but for every other slice, whose earliest is 10 µs late.
            let late = if (i as f64 * PERIOD / SLICE_S) as i64 % 2 == 0 {
                0
            } else {
                10_000
            };
            clock.observe(i, (i as f64 * PERIOD * 1e9) as i64 + late);
        }
        assert!((clock.residual_s() - 10e-6 / std::f64::consts::SQRT_2).abs() < 0.3e-6);
    }
}
