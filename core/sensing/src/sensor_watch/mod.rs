//! Whether a sensor's records can be the effect of a load: a record watch for values that stand
//! still, a jump watch for values that jump, a step watch for a zero that jumps.
//!
//! Called for every record before tare and filter: by `netft`, `franka`, and the closed loops of
//! `evaluate`.

mod jumps;
mod records;
mod steps;

pub use jumps::{JumpVerdict, JumpWatch, JumpWatchState};
pub use records::{RecordVerdict, RecordWatch, RecordWatchConfig, RecordWatchState};
pub use steps::{StepWatch, StepWatchState};

use nalgebra::Vector3;

use crate::SensorCondition;

/// Record watch, jump watch and step watch of one sensor. Their state is in [`SensorWatchState`].
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_sensing::{
///     RecordWatchConfig, SensorCondition, SensorRecord, SensorWatch, SensorWatchState, Watched,
/// };
///
/// let range = [130.0, 130.0, 400.0, 10.0, 10.0, 10.0];
/// let watch = SensorWatch::new(&RecordWatchConfig::default(), 1000.0, range, Vector3::zeros());
/// let mut state = SensorWatchState::default();
/// let record = SensorRecord {
///     counts: [100, -20, 5000, 3, 4, -1],
///     wrench: [0.1, -0.02, 5.0, 0.003, 0.004, -0.001],
///     condition: SensorCondition::Saturated,
///     missed: 0,
///     pressing_at: None,
///     felt_n: None,
/// };
/// // A condition that the sensor reports is passed on.
/// let expected = Watched::Take { condition: SensorCondition::Saturated, missed: 0 };
/// assert_eq!(watch.take(&mut state, &record), expected);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct SensorWatch {
    records: RecordWatch,
    jumps: JumpWatch,
    steps: StepWatch,
}

/// State of a [`SensorWatch`]. A new one is the reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorWatchState {
    records: RecordWatchState,
    jumps: JumpWatchState,
    steps: StepWatchState,
    left_out: u32,
    implausible: u64,
}

/// One record to be judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorRecord {
    /// Counts as the sensor sends them: Fx, Fy, Fz, Tx, Ty, Tz.
    pub counts: [i32; 6],
    /// Wrench of these counts: Fx, Fy, Fz, N, then Tx, Ty, Tz, Nm.
    pub wrench: [f64; 6],
    /// Condition that the sensor itself reports.
    pub condition: SensorCondition,
    /// Number of records lost before this one.
    pub missed: u32,
    /// Position of the tool while it is known to press, m, axes at rest; `None` otherwise.
    pub pressing_at: Option<Vector3<f64>>,
    /// Force that the readings before it have shown, with the zero subtracted, N; `None` without a
    /// zero.
    pub felt_n: Option<f64>,
}

/// Force above which a tool is known to press, N. It exceeds any zero, payload error or inertial
/// force of a commissioned cell.
const PRESSING_N: f64 = 1.0;

/// `position` (m) of a tool that is known to press, by the last `force` (N, tared); `None` if it
/// may be in free space.
pub fn pressing_at(position: Option<Vector3<f64>>, force: &Vector3<f64>) -> Option<Vector3<f64>> {
    position.filter(|_| force.norm() >= PRESSING_N)
}

/// What to do with one record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watched {
    /// The record is to be used, in this condition.
    Take {
        /// Condition that the sensor reports, or that the watch has found.
        condition: SensorCondition,
        /// Number of readings lost or left out since the one before.
        missed: u32,
    },
    /// The record is probably damaged, and counts as lost.
    LeaveOut,
}

impl SensorWatch {
    /// Watch of a sensor with `rate_hz` records per second, rated for `range` (N, then Nm; a range
    /// of 0 or infinity has no bound); the tool touches at `tip_in_sensor_m` (sensor axes, m).
    pub fn new(
        config: &RecordWatchConfig,
        rate_hz: f64,
        range: [f64; 6],
        tip_in_sensor_m: Vector3<f64>,
    ) -> Self {
        Self {
            records: RecordWatch::new(config, rate_hz),
            jumps: JumpWatch::new(rate_hz, range),
            steps: StepWatch::new(rate_hz, tip_in_sensor_m),
        }
    }

    /// Judges one record.
    pub fn take(&self, state: &mut SensorWatchState, record: &SensorRecord) -> Watched {
        let SensorRecord {
            counts,
            wrench,
            condition,
            missed,
            pressing_at,
            felt_n,
        } = record;
        let (condition, missed) = (*condition, *missed);
        let missed = missed.saturating_add(state.left_out);
        if condition != SensorCondition::Good {
            // A saturated gauge repeats the same reading, and returns with a jump.
            state.records.interrupt();
            state.jumps = JumpWatchState::default();
            state.steps = StepWatchState::default();
            state.left_out = 0;
            return Watched::Take { condition, missed };
        }
        let found = match self.records.take(&mut state.records, counts, *pressing_at) {
            RecordVerdict::Plausible => SensorCondition::Good,
            RecordVerdict::Frozen => SensorCondition::Frozen,
            RecordVerdict::AxisStuck(_) => SensorCondition::AxisStuck,
        };
        let jump = self.jumps.take(&mut state.jumps, wrench, missed);
        if jump != JumpVerdict::Plausible {
            state.implausible += 1;
        }
        let condition = match (found, jump) {
            (SensorCondition::Good, JumpVerdict::LeaveOut) => {
                state.left_out = missed.saturating_add(1);
                return Watched::LeaveOut;
            }
            (SensorCondition::Good, JumpVerdict::TooMany) => SensorCondition::Implausible,
            (found, _) => found,
        };
        let condition = match self.steps.take(&mut state.steps, wrench, *felt_n, missed) {
            true if condition == SensorCondition::Good => SensorCondition::ZeroJumped,
            _ => condition,
        };
        state.left_out = 0;
        Watched::Take { condition, missed }
    }
}

impl SensorWatchState {
    /// Axes whose value stands still: bit 0 is Fx, bit 5 is Tz.
    pub fn stuck_axes(&self) -> u8 {
        self.records.stuck_axes()
    }

    /// Number of records since the state was created whose jump no load can cause.
    pub fn implausible(&self) -> u64 {
        self.implausible
    }

    /// Restarts all watches. The count of implausible records continues.
    pub fn restart(&mut self) {
        *self = Self {
            implausible: self.implausible,
            ..Self::default()
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_left_out_is_a_lost_one_to_the_filter() {
        let watch = SensorWatch::new(
            &RecordWatchConfig::default(),
            7000.0,
            [130.0; 6],
            Vector3::zeros(),
        );
        let mut state = SensorWatchState::default();
        let mut take = |x: f64, missed| {
            let record = SensorRecord {
                counts: [(x * 1e6) as i32; 6],
                wrench: [x; 6],
                condition: SensorCondition::Good,
                missed,
                pressing_at: None,
                felt_n: None,
            };
            watch.take(&mut state, &record)
        };
        let good = |missed| Watched::Take {
            condition: SensorCondition::Good,
            missed,
        };
        assert_eq!(take(1.0, 0), good(0));
        assert_eq!(take(60.0, 2), Watched::LeaveOut);
        assert_eq!(take(1.1, 0), good(3));
        assert_eq!(take(1.0, 0), good(0));
        assert_eq!(state.implausible(), 1);
    }

    #[test]
    fn what_the_sensor_says_itself_comes_first() {
        let watch = SensorWatch::new(
            &RecordWatchConfig::default(),
            1000.0,
            [130.0; 6],
            Vector3::zeros(),
        );
        let mut state = SensorWatchState::default();
        for i in 0..5000 {
            let record = SensorRecord {
                counts: [i32::MAX; 6],
                wrench: [2000.0; 6],
                condition: SensorCondition::Saturated,
                missed: i % 2,
                pressing_at: None,
                felt_n: None,
            };
            let taken = watch.take(&mut state, &record);
            let said = Watched::Take {
                condition: SensorCondition::Saturated,
                missed: i % 2,
            };
            assert_eq!(taken, said);
        }
        assert_eq!(state.stuck_axes(), 0);
    }
}
