//! Poses of the tool over time.

use tangent_mechanics::{Base, Pose, Tool};
use tangent_schemas::tangent::ArmState;

/// States that are further apart than this leave a gap, ns.
const GAP_NS: u64 = 100_000_000;

/// Poses by time.
#[derive(Default)]
pub(crate) struct Poses(Vec<(u64, Pose<Base, Tool>)>);

impl Poses {
    /// Adds a state, unless its pose is not a pose or it is older than the one before.
    pub fn add(&mut self, time_ns: u64, state: &ArmState) {
        if let Ok(pose) = Pose::try_from(&state.tool_pose)
            && self.0.last().is_none_or(|(last, _)| *last < time_ns)
        {
            self.0.push((time_ns, pose));
        }
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The pose at a time, between the two states around it; `None` outside them and in a gap.
    pub fn at(&self, time_ns: u64) -> Option<Pose<Base, Tool>> {
        let after = self.0.partition_point(|(time, _)| *time <= time_ns);
        let (from_ns, from) = self.0.get(after.checked_sub(1)?)?;
        if *from_ns == time_ns {
            return Some(*from);
        }
        let (to_ns, to) = self.0.get(after)?;
        if to_ns - from_ns > GAP_NS {
            return None;
        }
        let share = (time_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        let rotation = from
            .rotation()
            .try_slerp(&to.rotation(), share, 1e-9)
            .unwrap_or(from.rotation());
        Some(Pose::new(
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
        let poses = Poses(vec![
            (0, pose(0.0)),
            (10_000_000, pose(0.1)),
            (900_000_000, pose(0.2)),
        ]);
        assert!((poses.at(5_000_000).unwrap().translation().x - 0.05).abs() < 1e-12);
        assert!(poses.at(500_000_000).is_none());
        assert!(poses.at(950_000_000).is_none());
    }
}
