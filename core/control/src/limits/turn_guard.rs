//! Whether the normal in use turns further than the way of the tool can explain.
//!
//! Called by the hybrid admittance in each cycle in which the tool presses. A surface turns under
//! the tool by at most its curvature times the way; what is left is the error of the first normal,
//! which is bounded. A normal that turns further follows a false force: a zero that has jumped, or
//! axes that are exchanged. The tool turns with it, and the force along it says ever less about the
//! true one.

use nalgebra::{Rotation3, Unit, Vector3};

use crate::contact::alignment::angle_between;

/// Curvature that is followed without doubt, 1/m: a radius of 25 mm.
const CURVATURE_PER_M: f64 = 40.0;
/// Distance around a place in which the tool may move to and fro without having got further, m:
/// small circles explore, they do not travel.
const LEASH_M: f64 = 0.006;

/// Normal that the way explains, and where. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TurnGuard {
    anchor: Option<(Vector3<f64>, Vector3<f64>)>,
    tripped: bool,
}

impl TurnGuard {
    /// Processes one cycle with the tool at `position` (m) and the `normal` in use (unit), axes in
    /// which the surface is at rest. Returns whether the normal has turned by more than `turn_max`
    /// (rad) beyond what the way explains. While the tool `explores`, it goes to and fro: only its
    /// distance from where it began explains a turn.
    pub fn step(
        &mut self,
        position: &Vector3<f64>,
        normal: &Vector3<f64>,
        turn_max_rad: f64,
        explores: bool,
    ) -> bool {
        let (at, explained) = self.anchor.get_or_insert((*position, *normal));
        let away = *position - *at;
        let beyond = away.norm() - LEASH_M;
        if beyond > 0.0 && !explores {
            *at += away.normalize() * beyond;
            let angle = angle_between(explained, normal);
            let axis = Unit::try_new(explained.cross(normal), 1e-9);
            if let Some(axis) = axis {
                let turn = angle.min(CURVATURE_PER_M * beyond);
                *explained = Rotation3::from_axis_angle(&axis, turn) * *explained;
            }
        }
        // An exploration over a curved surface comes back to where it began. Until then, the
        // normal turns with the distance from there.
        let away_rad = if explores {
            CURVATURE_PER_M * beyond.max(0.0)
        } else {
            0.0
        };
        let is_beyond = angle_between(explained, normal) > turn_max_rad + away_rad;
        self.tripped |= is_beyond;
        is_beyond
    }

    /// Whether the normal has ever turned further than explained.
    pub fn has_tripped(&self) -> bool {
        self.tripped
    }

    /// Direction (unit) away from a surface whose normal in use turned further than explained,
    /// after an approach along `approach` (unit): half-way between the normal that the way explains
    /// and the way that the tool came.
    pub fn way_off(&self, approach: &Vector3<f64>) -> Vector3<f64> {
        let explained = self.anchor.map_or(-approach, |(_, explained)| explained);
        (explained - approach)
            .try_normalize(1e-3)
            .unwrap_or(explained)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tilted(angle: f64) -> Vector3<f64> {
        Vector3::new(angle.sin(), 0.0, angle.cos())
    }

    #[test]
    fn a_surface_that_turns_under_the_tool_is_followed() {
        for radius in [0.03, 0.25] {
            let mut guard = TurnGuard::default();
            for k in 0..1000 {
                let angle = f64::from(k) * 2e-4 / radius;
                let place = Vector3::new(angle.sin(), 0.0, angle.cos()) * radius;
                assert!(
                    !guard.step(&place, &tilted(angle), 0.65, false),
                    "{radius}: {angle}"
                );
            }
        }
    }

    #[test]
    fn a_turn_without_way_is_bounded() {
        let mut guard = TurnGuard::default();
        let tripped = (0..1000).find_map(|k| {
            let angle = f64::from(k) * 2e-3;
            let circle = f64::from(k) * 0.05;
            let place = Vector3::new(circle.cos(), circle.sin(), 0.0) * 0.01;
            guard
                .step(&place, &tilted(angle), 0.65, true)
                .then_some(angle)
        });
        // The tool comes back to where it began once every 0.25 rad.
        assert!(tripped.is_some_and(|angle| angle < 0.8), "{tripped:?}");
        let mut guard = TurnGuard::default();
        let tripped = (0..1000).map(|k| f64::from(k) * 2e-3).find(|angle| {
            let place = Vector3::new(angle.cos(), angle.sin(), 0.0) * 0.002;
            guard.step(&place, &tilted(*angle), 0.65, true)
        });
        assert!(tripped.is_some_and(|angle| angle < 0.66), "{tripped:?}");
    }

    /// The bug: after a landing 26 degrees off, a circle of 10 mm on a torus of 50 mm was taken for
    /// a false force.
    #[test]
    fn an_exploration_over_a_curved_surface_is_followed() {
        let (radius, landed) = (0.05, 0.45);
        let mut guard = TurnGuard::default();
        assert!(!guard.step(&Vector3::zeros(), &tilted(-landed), 0.65, true));
        for k in 0..2000 {
            let angle = f64::from(k) * 0.01;
            let away = 0.01 * (1.0 - angle.cos());
            let place = Vector3::new(away, 0.01 * angle.sin(), 0.0);
            let normal = tilted(away / radius);
            assert!(!guard.step(&place, &normal, 0.65, true), "{angle}");
        }
    }

    #[test]
    fn the_way_off_does_not_follow_a_normal_that_has_turned() {
        let mut guard = TurnGuard::default();
        let approach = -Vector3::z();
        assert_eq!(guard.way_off(&approach), Vector3::z());
        for k in 0..1000 {
            guard.step(
                &Vector3::zeros(),
                &tilted(f64::from(k) * 1.6e-3),
                0.65,
                false,
            );
        }
        assert_eq!(guard.way_off(&approach), Vector3::z());
    }

    #[test]
    fn a_first_normal_that_is_25_degrees_wrong_may_be_corrected() {
        let mut guard = TurnGuard::default();
        for k in 0..500 {
            let angle = (f64::from(k) * 0.01).min(0.44);
            let place = Vector3::new(f64::from(k) * 1e-4, 0.0, 0.0);
            assert!(!guard.step(&place, &tilted(angle), 0.65, false));
        }
    }
}
