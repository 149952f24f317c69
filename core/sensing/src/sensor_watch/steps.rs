//! Detection of a zero that jumps: the reading follows a straight line, changes within one or two
//! milliseconds, and follows a line of about the same slope again.
//!
//! The force of a contact rises for as long as the tool moves into it, and an arm needs longer than
//! such a part to stop; a blow ends, or rings. A zero jumps where another client of the sensor
//! sets it, or where a gauge or a plug fails. A contact that moves from one edge to another may
//! also change the force at once, but then the torque about the sensor follows with the lever to
//! the tool's tip, and friction changes with the pressing force.

use nalgebra::Vector3;

/// Duration of one mean, s, and number of means of each straight part.
const MEAN_S: f64 = 1e-3;
const PART: usize = 20;
/// Number of means in all: one between the two parts, in which the step may lie.
const MEANS: usize = 2 * PART + 1;
/// Smallest step, N.
const STEP_N: f64 = 0.75;
/// Largest range of the means of a part about its line, as a share of the step, and largest change
/// from one line to the other within a part.
const UNREST_SHARE: f64 = 0.28;
const SLOPE_SHARE: f64 = 0.75;
/// Lowest rate of the records, Hz: below it, a load may rise from one record to the next.
const RATE_MIN_HZ: f64 = 400.0;
/// Share of the torque that a force across the lever would make, below which there was none.
const TORQUE_SHARE: f64 = 0.3;
/// Force across the lever, as a share of that along it, below which friction has not changed, and
/// the distance from the tip at which the force along it would act then, m.
const ACROSS_SHARE: f64 = 0.1;
const BESIDE_M: f64 = 0.005;
/// Reading of an axis after another program has set the zero, N and Nm: noise.
const ZERO_N: f64 = 0.2;
const ZERO_NM: f64 = 0.02;
/// Shortest lever by which a contact is told from a zero, m.
const LEVER_MIN_M: f64 = 0.02;

/// Detects a jump of the zero in a sensor's records.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_sensing::{StepWatch, StepWatchState};
///
/// // The tip is 0.1 m in front of the sensor.
/// let watch = StepWatch::new(1000.0, Vector3::new(0.0, 0.0, 0.1));
/// let mut state = StepWatchState::default();
/// let mut jumps = |z: f64| watch.take(&mut state, &[0.0, 0.0, z, 0.0, 0.0, 0.0], None, 0);
/// // Pressing with 5 N; then the zero jumps by 1 N.
/// let before = (0..100).any(|_| jumps(-5.0));
/// let after = (0..100).filter(|_| jumps(-4.0)).count();
/// assert_eq!((before, after), (false, 1));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct StepWatch {
    /// Number of records of one mean; 0: no watch.
    records: u32,
    tip_in_sensor_m: Vector3<f64>,
}

/// State of a [`StepWatch`]. A new one is the reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepWatchState {
    /// Means by axis, in a ring.
    means: [[f64; MEANS]; 6],
    /// Number of means so far, up to [`MEANS`], and the place of the next one.
    count: usize,
    next: usize,
    /// Sum of the records of the mean that is not complete, and their number.
    sum: [f64; 6],
    taken: u32,
}

impl Default for StepWatchState {
    fn default() -> Self {
        Self {
            means: [[0.0; MEANS]; 6],
            count: 0,
            next: 0,
            sum: [0.0; 6],
            taken: 0,
        }
    }
}

impl StepWatch {
    /// Watch for `rate_hz` records per second, none below 400; `tip_in_sensor_m` is where the tool
    /// touches, sensor axes, m.
    pub fn new(rate_hz: f64, tip_in_sensor_m: Vector3<f64>) -> Self {
        Self {
            records: if rate_hz >= RATE_MIN_HZ {
                ((MEAN_S * rate_hz).round() as u32).max(1)
            } else {
                0
            },
            tip_in_sensor_m,
        }
    }

    /// Processes one record (N and Nm), with `missed` records lost before it; `felt_n` is the force
    /// that the readings before it have shown, with the zero subtracted (N), if there is a zero.
    /// Returns whether the zero has jumped, once per jump, 20 ms after it.
    pub fn take(
        &self,
        state: &mut StepWatchState,
        wrench: &[f64; 6],
        felt_n: Option<f64>,
        missed: u32,
    ) -> bool {
        if self.records == 0 {
            return false;
        }
        if missed > self.records || !wrench.iter().all(|x| x.is_finite()) {
            *state = StepWatchState::default();
            return false;
        }
        for (sum, x) in state.sum.iter_mut().zip(wrench) {
            *sum += x;
        }
        state.taken += 1;
        if state.taken < self.records {
            return false;
        }
        let scale = 1.0 / f64::from(std::mem::take(&mut state.taken));
        let sum = std::mem::take(&mut state.sum);
        for (means, sum) in state.means.iter_mut().zip(sum) {
            means[state.next] = sum * scale;
        }
        state.next = (state.next + 1) % MEANS;
        state.count = (state.count + 1).min(MEANS);
        if state.count < MEANS {
            return false;
        }
        let jumps =
            (0..3).any(|axis| self.has_step(state, axis)) && self.is_no_contact(state, felt_n);
        if jumps {
            // It is found only in the middle of the means.
            *state = StepWatchState::default();
        }
        jumps
    }

    /// Whether there is a step in the middle of the means of an axis.
    fn has_step(&self, state: &StepWatchState, axis: usize) -> bool {
        // The neighbours of the middle rule out nearly everything.
        let beside = state.at(axis, PART + 1) - state.at(axis, PART - 1);
        if beside.abs() < (1.0 - UNREST_SHARE) * STEP_N {
            return false;
        }
        let [before, after] = state.parts(axis);
        let step = (after.middle - before.middle).abs();
        let unrest = UNREST_SHARE * step;
        // A mean of several records may hold a part of the step; a single record does not.
        let middle = state.at(axis, PART);
        let near = |part: &Part| (middle - part.middle).abs() <= unrest;
        step >= STEP_N
            && before.unrest.max(after.unrest) <= unrest
            && (after.slope - before.slope).abs() * PART as f64 <= SLOPE_SHARE * step
            && (self.records > 1 || near(&before) || near(&after))
    }

    /// Whether no contact at the tip changes force and torque as the step did, or all axes read
    /// zero after it although a tool without contact would not: another program has set the zero.
    fn is_no_contact(&self, state: &StepWatchState, felt_n: Option<f64>) -> bool {
        let parts: [[Part; 2]; 6] = std::array::from_fn(|axis| state.parts(axis));
        let is_zero = |axis: usize| {
            let most = if axis < 3 { ZERO_N } else { ZERO_NM };
            parts[axis][1].middle.abs() < most
        };
        let lever_m = self.tip_in_sensor_m.norm();
        let is_set = (0..6).all(is_zero) && felt_n.is_none_or(|felt_n| felt_n > ZERO_N);
        if lever_m < LEVER_MIN_M || is_set {
            return true;
        }
        let step = |axis: usize| parts[axis][1].middle - parts[axis][0].middle;
        let force = Vector3::new(step(0), step(1), step(2));
        let torque = Vector3::new(step(3), step(4), step(5));
        let along = self.tip_in_sensor_m / lever_m;
        let axial_n = force.dot(&along).abs();
        let across_n = (force - along * force.dot(&along)).norm();
        let aside = across_n >= STEP_N && torque.norm() < TORQUE_SHARE * lever_m * across_n;
        let straight = across_n < ACROSS_SHARE * axial_n && torque.norm() < BESIDE_M * axial_n;
        aside || straight
    }
}

impl StepWatchState {
    /// The mean with this number, from the oldest.
    fn at(&self, axis: usize, number: usize) -> f64 {
        self.means[axis][(self.next + number) % MEANS]
    }

    /// The lines before the middle and after it, by least squares.
    fn parts(&self, axis: usize) -> [Part; 2] {
        [0, PART + 1].map(|from| {
            let centre = 0.5 * (PART - 1) as f64;
            let points = || (0..PART).map(|k| (k as f64 - centre, self.at(axis, from + k)));
            let mean = points().map(|(_, y)| y).sum::<f64>() / PART as f64;
            let slope = points().map(|(x, y)| x * y).sum::<f64>()
                / points().map(|(x, _)| x * x).sum::<f64>();
            let off_line = points().map(|(x, y)| y - mean - slope * x);
            let (low, high) = off_line.fold((0.0_f64, 0.0_f64), |(low, high), off| {
                (low.min(off), high.max(off))
            });
            let to_middle = PART as f64 - from as f64 - centre;
            Part {
                middle: mean + slope * to_middle,
                slope,
                unrest: high - low,
            }
        })
    }
}

/// A line through the means of one part.
struct Part {
    /// Value at the middle of all means.
    middle: f64,
    /// Change from one mean to the next.
    slope: f64,
    /// Range of the means about the line.
    unrest: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIP_M: Vector3<f64> = Vector3::new(0.0, 0.0, 0.1);

    /// Number of jumps found in `force` (N) along z over 2 s, with a noise of `noise_n`.
    fn found(rate_hz: f64, noise_n: f64, force: impl Fn(f64) -> f64) -> usize {
        let watch = StepWatch::new(rate_hz, TIP_M);
        let mut state = StepWatchState::default();
        let mut random = 1_u64;
        let mut noise = || {
            let sum: f64 = (0..12)
                .map(|_| {
                    random = random
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1);
                    (random >> 33) as f64 / f64::from(1_u32 << 31)
                })
                .sum();
            noise_n * (sum - 6.0)
        };
        (0..(2.0 * rate_hz) as u32)
            .filter(|k| {
                let z = force(f64::from(*k) / rate_hz) + noise();
                watch.take(&mut state, &[noise(), noise(), z, 0.0, 0.0, 0.0], None, 0)
            })
            .count()
    }

    /// Noise of a record at this rate, N, of a sensor with 2 mN/√Hz.
    fn noise_n(rate_hz: f64) -> f64 {
        0.002 * (0.5 * rate_hz).sqrt()
    }

    #[test]
    fn a_zero_that_jumps_by_a_newton_is_found_once() {
        for rate_hz in [500.0, 1000.0, 7000.0] {
            for step_n in [-3.0, -1.0, 1.0, 3.0, 20.0] {
                for at_s in [0.5, 0.5003, 0.5007] {
                    let count = found(rate_hz, noise_n(rate_hz), |t| {
                        -3.0 + if t > at_s { step_n } else { 0.0 }
                    });
                    assert_eq!(count, 1, "{step_n} N at {rate_hz} Hz");
                }
            }
        }
    }

    #[test]
    fn the_force_of_a_contact_is_no_jump() {
        for rate_hz in [500.0, 1000.0, 7000.0] {
            let noise_n = noise_n(rate_hz);
            // Into 5 to 100 kN/m at 1 to 80 mm/s, for 30 ms; then the tool stands.
            for stiffness in [5e3, 2.5e4, 1e5] {
                for speed in [1e-3, 5e-3, 2e-2, 8e-2] {
                    let rise = |t: f64| -stiffness * speed * (t - 0.5).clamp(0.0, 0.03);
                    assert_eq!(found(rate_hz, noise_n, rise), 0, "{stiffness}, {speed}");
                    let fall = |t: f64| -rise(t) - 5.0;
                    assert_eq!(found(rate_hz, noise_n, fall), 0, "{stiffness}, {speed}");
                }
            }
            // Vibration, and slips of 1 N within 6 ms.
            for hz in [3.0, 12.0, 40.0, 150.0] {
                let swings = |t: f64| -3.0 + 1.5 * (std::f64::consts::TAU * hz * t).sin();
                assert_eq!(found(rate_hz, noise_n, swings), 0, "{hz} Hz");
            }
            let slips = |t: f64| {
                let part = t.rem_euclid(0.1);
                -3.0 + part.min(0.094) / 0.094 - ((part - 0.094).max(0.0) / 0.006).min(1.0)
            };
            assert_eq!(found(rate_hz, noise_n, slips), 0);
        }
    }

    /// A contact that moves to another edge, with force and torque that change at once.
    #[test]
    fn a_force_that_jumps_with_its_friction_or_its_torque_is_no_jump_of_the_zero() {
        let jumps = |force: [f64; 3], acts_at_m: Option<Vector3<f64>>| {
            let watch = StepWatch::new(1000.0, TIP_M);
            let mut state = StepWatchState::default();
            let force = Vector3::from(force);
            let torque = acts_at_m.map_or(Vector3::zeros(), |at| at.cross(&force));
            (0..200).any(|k| {
                let share = f64::from(u8::from(k >= 100));
                let (f, t) = (force * share, torque * share);
                watch.take(&mut state, &[f.x, f.y, f.z - 5.0, t.x, t.y, t.z], None, 0)
            })
        };
        for tip in [TIP_M, TIP_M + Vector3::new(0.004, -0.003, 0.0)] {
            assert!(!jumps([1.0, 0.0, 0.0], Some(tip)));
            assert!(!jumps([0.5, 0.5, 2.0], Some(tip)));
        }
        assert!(!jumps([0.0, 0.0, 2.0], Some(TIP_M + Vector3::x() * 0.01)));
        assert!(jumps([1.0, 0.0, 0.0], None));
        assert!(jumps([1.0, 0.0, 2.0], None));
        assert!(jumps([0.0, 0.0, -1.0], None));
    }

    /// Pressing with 5 N and friction of 2 N; then all axes read zero.
    #[test]
    fn a_zero_set_by_another_program_is_found_unless_the_tool_may_have_come_off() {
        for (felt_n, expected) in [(None, true), (Some(8.0), true), (Some(0.1), false)] {
            let watch = StepWatch::new(1000.0, TIP_M);
            let mut state = StepWatchState::default();
            let found = (0..200).any(|k| {
                let share = f64::from(u8::from(k < 100));
                let record = [2.0, 0.0, -5.0, 0.0, 0.2, 0.0].map(|x| x * share);
                watch.take(&mut state, &record, felt_n, 0)
            });
            assert_eq!(found, expected, "{felt_n:?}");
        }
    }

    /// Physics of another simulator, with a force that is held for a period of the arm.
    #[test]
    fn a_rise_in_stairs_of_an_arms_period_is_no_jump() {
        for period_s in [0.002, 0.008] {
            let stairs =
                |t: f64| -200.0 * ((t - 0.5).clamp(0.0, 0.1) / period_s).floor() * period_s;
            assert_eq!(found(1000.0, 0.0, stairs), 0, "{period_s}");
        }
    }

    #[test]
    fn noise_alone_is_no_jump_and_lost_records_are_none() {
        for noise_n in [0.05, 0.3, 1.0] {
            assert_eq!(found(7000.0, noise_n, |_| -3.0), 0, "{noise_n}");
        }
        let watch = StepWatch::new(1000.0, TIP_M);
        let mut state = StepWatchState::default();
        for k in 0..200 {
            let z = if k < 100 { -3.0 } else { -5.0 };
            let missed = if k == 100 { 50 } else { 0 };
            assert!(!watch.take(&mut state, &[0.0, 0.0, z, 0.0, 0.0, 0.0], None, missed));
        }
        // A slow sensor is not watched.
        assert_eq!(found(125.0, 0.0, |t| if t < 1.0 { 0.0 } else { 3.0 }), 0);
    }
}
