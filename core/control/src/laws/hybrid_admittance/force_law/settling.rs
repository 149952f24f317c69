//! Depth of a tool that settles on the surface, and whether it shows the stiffness.
//!
//! A tool that turns while it stands on one side of its tip moves along the normal without changing
//! the force: the force law makes up for the turn. Such a way looks like a soft contact, and a law
//! that believes it is too fast for the true one.

use nalgebra::Vector3;
use tangent_mechanics::{Base, Pose, Tool};

use super::super::stiffness::MEMORY_S;

/// Way along the normal that the tool's turns may make, as a share of the depth, and m.
const TURNED_SHARE: f64 = 0.2;
const TURNED_M: f64 = 2e-5;

/// State for one contact. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Settling {
    pose: Option<Pose<Base, Tool>>,
    /// Depth along the normal, m, summed from increments: the normal may turn meanwhile, and the
    /// origin is far away.
    depth_m: f64,
    deepest_m: f64,
    /// Way along the normal, forth and back, on which turns have moved the point where the force
    /// acts, m, as long as the stiffness remembers them.
    turned_m: f64,
}

impl Settling {
    /// Adds a cycle, with the point where the force acts in tool axes.
    pub fn add(
        &mut self,
        base_from_tool: &Pose<Base, Tool>,
        acting_in_tool_m: &Vector3<f64>,
        normal: &Vector3<f64>,
        dt_s: f64,
    ) {
        let before = self
            .pose
            .replace(*base_from_tool)
            .unwrap_or(*base_from_tool);
        let step = base_from_tool.translation() - before.translation();
        let turned = base_from_tool.rotate(acting_in_tool_m) - before.rotate(acting_in_tool_m);
        self.depth_m -= step.dot(normal);
        self.deepest_m = self.deepest_m.max(self.depth_m);
        self.turned_m *= (-dt_s / MEMORY_S).exp();
        self.turned_m += turned.dot(normal).abs();
    }

    /// Depth along the normal, m.
    pub fn depth_m(&self) -> f64 {
        self.depth_m
    }

    /// Whether the tool's turns have too large a part in the depth.
    pub fn is_turned(&self) -> bool {
        self.turned_m > TURNED_SHARE * self.deepest_m + TURNED_M
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// Depth, and whether turns count, while the tool goes in by `way_m` and turns by `turn_rad`
    /// about its x axis, and then stands.
    fn settled(way_m: f64, turn_rad: f64) -> Vec<(f64, bool)> {
        let mut settling = Settling::default();
        let acting = Vector3::new(0.0, 0.01, 0.0);
        (0..=600)
            .map(|i| {
                let share = (f64::from(i) / 100.0).min(1.0);
                let pose = Pose::new(
                    Vector3::new(0.4, 0.1, 0.2 - way_m * share),
                    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), turn_rad * share),
                );
                settling.add(&pose, &acting, &Vector3::z(), 0.008);
                (settling.depth_m(), settling.is_turned())
            })
            .collect()
    }

    #[test]
    fn the_depth_counts_while_turns_have_little_part_in_it() {
        let straight = settled(4e-4, 0.0);
        assert!(straight.iter().all(|(_, turned)| !turned));
        assert!((straight[100].0 - 4e-4).abs() < 1e-12);
        assert!(settled(4e-4, 0.008).iter().all(|(_, turned)| !turned));
    }

    #[test]
    fn a_large_turn_counts_until_it_is_forgotten() {
        let turning = settled(4e-4, 0.1);
        let straight = turning.iter().take_while(|(_, turned)| !turned).count();
        assert!((1..50).contains(&straight), "{straight}");
        assert!(turning[straight..=100].iter().all(|(_, turned)| *turned));
        assert!(!turning[600].1);
    }
}
