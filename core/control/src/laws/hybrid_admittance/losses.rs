//! Losses of contact by place: one that repeats where it happened before changes the approach, and
//! then ends the task.
//!
//! Called by the phase machine at each loss, and by the motion.

use nalgebra::Vector3;

/// Distance within which losses are at one place, m.
const PLACE_M: f64 = 0.01;
/// Losses at one place from which the tool moves slower there, by this factor for each more.
const SLOWER_FROM: u32 = 2;
const SLOWER_FACTOR: f64 = 0.6;
/// Slowest share of the speed.
const SHARE_MIN: f64 = 0.1;

/// State for one run. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Losses {
    place: Option<Vector3<f64>>,
    here: u32,
}

impl Losses {
    /// Counts a loss at `position` (m); returns how many were at this place.
    pub fn count(&mut self, position: &Vector3<f64>) -> u32 {
        if self.is_near(position) {
            self.here += 1;
        } else {
            self.place = Some(*position);
            self.here = 1;
        }
        self.here
    }

    /// Share of a speed, of the path or towards the surface, that is left at `position` (m).
    pub fn speed_share(&self, position: &Vector3<f64>) -> f64 {
        if self.here <= SLOWER_FROM || !self.is_near(position) {
            return 1.0;
        }
        let more = i32::try_from(self.here - SLOWER_FROM).unwrap_or(i32::MAX);
        SLOWER_FACTOR.powi(more).max(SHARE_MIN)
    }

    fn is_near(&self, position: &Vector3<f64>) -> bool {
        self.place
            .is_some_and(|place| (position - place).norm() < PLACE_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_at_one_place_slow_the_tool_there_and_only_there() {
        let mut losses = Losses::default();
        let (here, there) = (Vector3::zeros(), Vector3::x() * 0.02);
        let counts: Vec<_> = (0..4).map(|_| losses.count(&here)).collect();
        assert_eq!(counts, [1, 2, 3, 4]);
        assert!(losses.speed_share(&here) < 0.5);
        assert_eq!(losses.speed_share(&there), 1.0);
        assert_eq!(losses.count(&there), 1);
        assert_eq!(losses.speed_share(&there), 1.0);
    }
}
