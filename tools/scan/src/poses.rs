//! Poses of the tool over time.

use std::collections::VecDeque;

use tangent_mechanics::{Base, Pose, Tool};
use tangent_schemas::tangent::ArmState;

/// States that are further apart than this leave a gap, ns.
const GAP_NS: i64 = 100_000_000;
/// Poses that are older than the newest one by more than this are forgotten, ns. More than the
/// largest delay of an image.
const KEPT_NS: i64 = 5_000_000_000;

/// Poses by time, the newest last.
#[derive(Debug, Default)]
pub(crate) struct Poses(VecDeque<(i64, Pose<Base, Tool>)>);

/// Why there is no pose at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoPose {
    /// The time is later than that of the newest state.
    NotYet,
    /// The time is in a gap, or before the oldest state that is kept.
    Never,
}

impl Poses {
    /// Adds a state, unless its pose is not a pose or it is older than the one before.
    pub fn add(&mut self, state: &ArmState) {
        let Ok(pose) = Pose::try_from(&state.tool_pose) else {
            return;
        };
        let time_ns = state.header.stamp.to_ns();
        if let Some(newest_ns) = self.newest_ns() {
            if newest_ns - time_ns > KEPT_NS {
                // The clock of the arm's host was set back.
                self.0.clear();
            } else if time_ns <= newest_ns {
                return;
            }
        }
        self.0.push_back((time_ns, pose));
        while self.0.front().is_some_and(|(t, _)| time_ns - t > KEPT_NS) {
            self.0.pop_front();
        }
    }

    /// Time of the newest state, ns.
    pub fn newest_ns(&self) -> Option<i64> {
        self.0.back().map(|(time, _)| *time)
    }

    /// The pose at a time, between the two states around it.
    pub fn at(&self, time_ns: i64) -> Result<Pose<Base, Tool>, NoPose> {
        let after = self.0.partition_point(|(time, _)| *time <= time_ns);
        let from = after.checked_sub(1).and_then(|k| self.0.get(k));
        let (from_ns, from) = from.ok_or(match self.0.is_empty() {
            true => NoPose::NotYet,
            false => NoPose::Never,
        })?;
        if *from_ns == time_ns {
            return Ok(*from);
        }
        let (to_ns, to) = self.0.get(after).ok_or(NoPose::NotYet)?;
        if to_ns - from_ns > GAP_NS {
            return Err(NoPose::Never);
        }
        let share = (time_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        let rotation = from
            .rotation()
            .try_slerp(&to.rotation(), share, 1e-9)
            .unwrap_or(from.rotation());
        Ok(Pose::new(
            from.translation().lerp(&to.translation(), share),
            rotation,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn a_pose_is_taken_between_two_states_and_not_in_a_gap() {
        let pose = |x: f64| Pose::new(Vector3::new(x, 0.0, 0.0), UnitQuaternion::identity());
        let poses = Poses(VecDeque::from([
            (0, pose(0.0)),
            (10_000_000, pose(0.1)),
            (900_000_000, pose(0.2)),
        ]));
        assert!((poses.at(5_000_000).unwrap().translation().x - 0.05).abs() < 1e-12);
        assert_eq!(poses.at(500_000_000), Err(NoPose::Never));
        assert_eq!(poses.at(-1), Err(NoPose::Never));
        assert_eq!(poses.at(950_000_000), Err(NoPose::NotYet));
        assert_eq!(Poses::default().at(0), Err(NoPose::NotYet));
    }

    #[test]
    fn old_and_reordered_states_are_not_kept_and_a_clock_that_was_set_back_begins_anew() {
        let mut poses = Poses::default();
        let mut add = |at_ns: i64| {
            let mut state = ArmState::default();
            state.header.stamp = tangent_schemas::standard::Header::new(at_ns, "base").stamp;
            state.tool_pose.orientation.w = 1.0;
            poses.add(&state);
            (poses.0.len(), poses.newest_ns())
        };
        assert_eq!(add(10_000_000_000), (1, Some(10_000_000_000)));
        assert_eq!(add(9_999_000_000), (1, Some(10_000_000_000)));
        assert_eq!(add(10_050_000_000), (2, Some(10_050_000_000)));
        assert_eq!(add(16_000_000_000), (1, Some(16_000_000_000)));
        assert_eq!(add(2_000_000_000), (1, Some(2_000_000_000)));
    }
}
