//! Detects a frozen wrench estimate of the robot. The estimate is based on torques measured with
//! noise, so it never repeats by chance.

use nalgebra::Vector6;
use tangent_sensing::{
    RecordVerdict, RecordWatch, RecordWatchConfig, RecordWatchState, SensorCondition,
};

use crate::fci::PERIOD_S;

/// Resolution for detecting a change, in parts per newton or newton metre: the robot's numbers are
/// of single precision.
const COUNTS_PER_UNIT: f64 = 1e6;

/// The record watch of `tangent_sensing`, applied to the estimate once per state of the robot.
#[derive(Clone, Debug)]
pub(crate) struct WrenchWatch {
    watch: RecordWatch,
    state: RecordWatchState,
}

impl Default for WrenchWatch {
    fn default() -> Self {
        Self {
            watch: RecordWatch::new(&RecordWatchConfig::default(), 1.0 / PERIOD_S),
            state: RecordWatchState::default(),
        }
    }
}

impl WrenchWatch {
    /// Takes one untared estimate, N and Nm.
    pub(crate) fn take(&mut self, wrench: &Vector6<f64>) -> SensorCondition {
        // `as` saturates at the limits of the integer, far beyond any load.
        let counts = std::array::from_fn(|i| (wrench[i] * COUNTS_PER_UNIT).round() as i32);
        match self.watch.take(&mut self.state, &counts, None) {
            RecordVerdict::Plausible => SensorCondition::Good,
            RecordVerdict::Frozen => SensorCondition::Frozen,
            RecordVerdict::AxisStuck(_) => SensorCondition::AxisStuck,
        }
    }

    /// Axes whose value stands still: bit 0 Fx to bit 5 Tz.
    pub(crate) fn stuck_axes(&self) -> u8 {
        self.state.stuck_axes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(k: u32) -> Vector6<f64> {
        Vector6::from_fn(|i, _| {
            let noise = f64::from((k * 7919 + 104_729 * i as u32) % 1009) / 1009.0 - 0.5;
            -15.0 + 0.3 * noise
        })
    }

    #[test]
    fn an_estimate_that_stands_still_is_noticed_within_two_cycles_of_a_controller() {
        let mut watch = WrenchWatch::default();
        for k in 0..3000 {
            assert_eq!(watch.take(&estimate(k)), SensorCondition::Good);
        }
        let last = estimate(2999);
        let states = (1..100).find(|_| watch.take(&last) == SensorCondition::Frozen);
        assert!(states.is_some_and(|n| n <= 4), "{states:?}");
        assert_eq!(watch.stuck_axes(), 0x3f);
    }

    #[test]
    fn a_robot_whose_estimate_is_always_zero_is_not_judged() {
        let mut watch = WrenchWatch::default();
        for _ in 0..5000 {
            assert_eq!(watch.take(&Vector6::zeros()), SensorCondition::Good);
        }
    }
}
