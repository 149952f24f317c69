//! Detection of records that jump and return, as no load does: well-formed records that were
//! damaged in transmission or in the sensor.
//!
//! A load may rise within one record (a collision), but then the next record is near the new value.
//! A single record far from both its neighbours cannot be a load. Therefore a jump counts only once
//! the next record confirms it.

/// Step between two successive records that is always allowed, as a share of the rated load.
const SHARE: f64 = 0.05;
/// Additional allowed step per second between the records, as a share of the rated load: 2000 N/s
/// for a range of 130 N, as when a tool meets 25 kN/m at 80 mm/s.
const SHARE_PER_S: f64 = 15.0;
/// Factor by which a step may exceed the one before it.
const GROWTH: f64 = 1.5;
/// Largest number of records left out among the last 32; beyond it, the sensor is not usable.
const LEFT_OUT_MAX: u32 = 6;

/// Verdict on the step to one record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JumpVerdict {
    /// A load can cause the step, or the record confirms the jump before it.
    Plausible,
    /// The record is too far from the last accepted one; it is left out unless the next confirms
    /// it.
    LeaveOut,
    /// The record is left out, as were too many of those before it.
    TooMany,
}

/// Bounds on the step from one record to the next.
///
/// ```
/// use tangent_sensing::{JumpVerdict, JumpWatch, JumpWatchState};
///
/// let watch = JumpWatch::new(1000.0, [100.0, 100.0, 100.0, 10.0, 10.0, 10.0]);
/// let mut state = JumpWatchState::default();
/// let (rest, hit) = ([0.0; 6], [0.0, 0.0, -50.0, 0.0, 0.0, 0.0]);
/// assert_eq!(watch.take(&mut state, &rest, 0), JumpVerdict::Plausible);
/// assert_eq!(watch.take(&mut state, &hit, 0), JumpVerdict::LeaveOut);
/// // The next record is near it: the jump was a collision.
/// assert_eq!(watch.take(&mut state, &hit, 0), JumpVerdict::Plausible);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct JumpWatch {
    range: [f64; 6],
    period_s: f64,
}

/// State of a [`JumpWatch`]. A new one is the reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JumpWatchState {
    /// Last accepted record, N and Nm.
    last: Option<[f64; 6]>,
    /// Record whose jump is not yet confirmed.
    suspect: Option<[f64; 6]>,
    /// Step to the last accepted record, as a share of the range: a rising load continues to rise.
    stride: f64,
    /// One bit per record, the newest lowest; 1 if it was left out.
    left_out: u32,
}

impl JumpWatch {
    /// Watch for `rate_hz` records per second of a sensor rated for `range` (N, then Nm). An axis
    /// with range 0 or infinity has no bound.
    pub fn new(rate_hz: f64, range: [f64; 6]) -> Self {
        Self {
            range: range.map(|r| if r > 0.0 { r } else { f64::INFINITY }),
            period_s: if rate_hz > 0.0 { 1.0 / rate_hz } else { 1.0 },
        }
    }

    /// Judges one record (N and Nm), with `missed` records lost before it.
    pub fn take(&self, state: &mut JumpWatchState, wrench: &[f64; 6], missed: u32) -> JumpVerdict {
        let Some(last) = state.last else {
            state.last = Some(*wrench);
            return JumpVerdict::Plausible;
        };
        state.left_out <<= 1;
        let periods = f64::from(missed.min(10_000)) + 1.0;
        let bound = (SHARE + SHARE_PER_S * self.period_s * periods).max(GROWTH * state.stride);
        let away = self.distance(wrench, &last);
        let step = state
            .suspect
            .map_or(away, |suspect| self.distance(wrench, &suspect));
        let confirmed = state.suspect.is_some() && step <= away;
        if away <= bound || confirmed {
            if confirmed && away > bound {
                // The jump before was a load.
                state.left_out &= !2;
            }
            state.stride = step.min(away);
            state.last = Some(*wrench);
            state.suspect = None;
            return JumpVerdict::Plausible;
        }
        state.suspect = Some(*wrench);
        state.left_out |= 1;
        if state.left_out.count_ones() > LEFT_OUT_MAX {
            JumpVerdict::TooMany
        } else {
            JumpVerdict::LeaveOut
        }
    }

    /// Largest difference on any axis, as a share of its range; infinite if a number is NaN.
    fn distance(&self, a: &[f64; 6], b: &[f64; 6]) -> f64 {
        let mut most: f64 = 0.0;
        for i in 0..6 {
            let d = (a[i] - b[i]).abs() / self.range[i];
            if d.is_nan() {
                return f64::INFINITY;
            }
            most = most.max(d);
        }
        most
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: [f64; 6] = [130.0, 130.0, 400.0, 10.0, 10.0, 10.0];

    fn run(rate_hz: f64, forces: &[f64]) -> Vec<JumpVerdict> {
        let watch = JumpWatch::new(rate_hz, RANGE);
        let mut state = JumpWatchState::default();
        forces
            .iter()
            .map(|f| watch.take(&mut state, &[0.0, *f, 0.0, 0.0, 0.0, 0.0], 0))
            .collect()
    }

    #[test]
    fn a_record_that_leaps_there_and_back_does_not_count() {
        use JumpVerdict::{LeaveOut, Plausible};
        let found = run(7000.0, &[3.0, 3.1, 40.0, 3.0, -50.0, 3.1, 3.0]);
        let expected = [
            Plausible, Plausible, LeaveOut, Plausible, LeaveOut, Plausible, Plausible,
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn a_collision_counts_from_its_second_record_on() {
        for rate_hz in [7000.0, 1000.0, 125.0] {
            let found = run(rate_hz, &[3.0, 60.0, 65.0, 62.0, 60.0, 58.0]);
            let out = found
                .iter()
                .filter(|v| **v != JumpVerdict::Plausible)
                .count();
            assert!(out <= 1, "{rate_hz} Hz: {found:?}");
            assert_eq!(found[2], JumpVerdict::Plausible, "{rate_hz} Hz");
        }
        // One that still rises.
        let found = run(1000.0, &[0.0, 30.0, 60.0, 90.0, 100.0, 95.0]);
        assert_eq!(found[2..], [JumpVerdict::Plausible; 4]);
    }

    #[test]
    fn pressing_on_stiff_surfaces_is_no_leap() {
        // 50 kN/m at 40 mm/s, and the ringing of a tool on it, by every record.
        for rate_hz in [7000.0, 1000.0] {
            let rise: Vec<f64> = (0..200)
                .map(|i| {
                    let t = f64::from(i) / rate_hz;
                    (2000.0 * t).min(60.0) + 3.0 * (400.0 * t).sin()
                })
                .collect();
            assert!(
                run(rate_hz, &rise)
                    .iter()
                    .all(|v| *v == JumpVerdict::Plausible)
            );
        }
    }

    #[test]
    fn noise_in_place_of_readings_is_soon_too_much() {
        let wild: Vec<f64> = (0..40)
            .map(|i| f64::from(i * 7919 % 101) - 50.0)
            .map(|x| if x.abs() < 10.0 { 90.0 } else { 2.0 * x })
            .collect();
        let found = run(7000.0, &wild);
        let first = found.iter().position(|v| *v == JumpVerdict::TooMany);
        assert!(first.is_some_and(|at| at < 32), "{found:?}");
    }

    #[test]
    fn no_range_is_no_bound() {
        let watch = JumpWatch::new(1000.0, [0.0; 6]);
        let mut state = JumpWatchState::default();
        for x in [0.0, 1e6, -1e6, 0.0] {
            assert_eq!(watch.take(&mut state, &[x; 6], 0), JumpVerdict::Plausible);
        }
    }

    #[test]
    fn a_reading_that_is_no_number_is_no_load() {
        let watch = JumpWatch::new(1000.0, RANGE);
        let mut state = JumpWatchState::default();
        watch.take(&mut state, &[0.0; 6], 0);
        assert_eq!(
            watch.take(&mut state, &[f64::NAN; 6], 0),
            JumpVerdict::LeaveOut
        );
        assert_eq!(watch.take(&mut state, &[0.1; 6], 0), JumpVerdict::Plausible);
    }
}
