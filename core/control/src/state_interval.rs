//! Time between two states of the robot.

/// Measures time by the robot's clock. States may be lost between robot and loop, so the law must
/// not count the states that arrived.
///
/// ```
/// use tangent_control::StateInterval;
///
/// let mut interval = StateInterval::default();
/// assert_eq!(interval.step(10.000, 0.008), 0.008);
/// assert_eq!(interval.step(10.008, 0.008), 0.008);
/// // The state at 10.016 s was lost.
/// assert_eq!(interval.step(10.024, 0.008), 0.016);
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct StateInterval {
    last_s: Option<f64>,
}

impl StateInterval {
    /// Maximum number of periods that one state represents. Beyond it the bridge has begun to stop
    /// the arm, and a filter would not be accurate with so long a step.
    pub const MOST_PERIODS: f64 = 4.0;

    /// Time since the previous state, s: whole periods of `period_s`, at least one and at most
    /// [`Self::MOST_PERIODS`]. One period if the robot's time `robot_time_s` (s) gives no interval:
    /// in the first state, after a restart, or when it stands still.
    pub fn step(&mut self, robot_time_s: f64, period_s: f64) -> f64 {
        let last_s = self.last_s.replace(robot_time_s);
        let periods = last_s.map_or(1.0, |last_s| ((robot_time_s - last_s) / period_s).round());
        // NaN counts as one period.
        let periods = if periods >= 1.0 { periods } else { 1.0 };
        period_s * periods.min(Self::MOST_PERIODS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.008;

    #[test]
    fn a_lost_state_makes_the_next_one_longer() {
        let mut interval = StateInterval::default();
        // The robot's clock has a microsecond's noise.
        for (robot_time_s, periods) in [
            (100.0, 1.0),
            (100.008_001, 1.0),
            (100.015_999, 1.0),
            (100.032, 2.0),
            (100.040, 1.0),
            (101.0, StateInterval::MOST_PERIODS),
        ] {
            assert_eq!(interval.step(robot_time_s, PERIOD_S), periods * PERIOD_S);
        }
    }

    #[test]
    fn a_clock_that_says_nothing_makes_it_one_period() {
        let mut interval = StateInterval::default();
        for robot_time_s in [5.0, 5.0, 1.0, f64::NAN, 1.008, f64::NEG_INFINITY] {
            assert_eq!(interval.step(robot_time_s, PERIOD_S), PERIOD_S);
        }
        assert_eq!(
            interval.step(f64::INFINITY, PERIOD_S),
            StateInterval::MOST_PERIODS * PERIOD_S
        );
    }
}
