//! Pose, velocity and acceleration from a sequence of poses: a critically damped filter of third
//! order.
//!
//! The fading-memory polynomial filter of second degree (Brookner, *Tracking and Kalman Filtering
//! Made Easy*, 1998, ch. 7): `θ = exp(-ω T)`, gains `1 - θ³`, `1.5 (1 - θ²)(1 - θ) / T`,
//! `(1 - θ)³ / T²`. Its three poles are at `-ω`; a constant velocity and a constant acceleration
//! leave no lag. Rotations between samples are small and are filtered as rotation vectors in world
//! axes.

use nalgebra::{UnitQuaternion, Vector3};
use tangent_mechanics::{Base, Pose, World};

/// Pose and motion of the base, world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PoseFilter {
    /// Origin of the base, m.
    pub position: Vector3<f64>,
    /// Rotation from base axes to world axes.
    pub rotation: UnitQuaternion<f64>,
    /// Linear velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub turn_rate: Vector3<f64>,
    /// Linear acceleration, m/s².
    acceleration: Vector3<f64>,
    /// Angular acceleration, rad/s².
    turn_acceleration: Vector3<f64>,
}

/// Time for which an estimated acceleration is extrapolated, s.
const ACCELERATION_LASTS_S: f64 = 0.1;
/// Time constant with which an extrapolated velocity decays once it is no longer known, s.
const VELOCITY_FADES_S: f64 = 0.3;

impl PoseFilter {
    /// A base at rest at `pose`.
    pub fn at_rest(pose: &Pose<World, Base>) -> Self {
        Self {
            position: pose.translation(),
            rotation: pose.rotation(),
            velocity: Vector3::zeros(),
            turn_rate: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            turn_acceleration: Vector3::zeros(),
        }
    }

    /// Pose of the base.
    pub fn pose(&self) -> Pose<World, Base> {
        Pose::new(self.position, self.rotation)
    }

    /// State extrapolated by `dt_s`, s. Beyond `known_s` the velocity decays, as no measurement
    /// confirms it.
    pub fn after(&self, dt_s: f64, known_s: f64) -> Self {
        let dt_s = dt_s.max(0.0);
        let bent = dt_s.min(ACCELERATION_LASTS_S);
        let straight = dt_s.min(known_s) - dt_s.min(known_s).min(bent);
        let beyond = (dt_s - known_s.max(bent)).max(0.0);
        let fading = (-beyond / VELOCITY_FADES_S).exp();
        let way = |v: &Vector3<f64>, a: &Vector3<f64>| {
            let then = v + a * bent;
            let after = straight + VELOCITY_FADES_S * (1.0 - fading);
            (
                v * bent + a * (0.5 * bent * bent) + then * after,
                then * fading,
            )
        };
        let (step, velocity) = way(&self.velocity, &self.acceleration);
        let (turn, turn_rate) = way(&self.turn_rate, &self.turn_acceleration);
        Self {
            position: self.position + step,
            rotation: UnitQuaternion::new(turn) * self.rotation,
            velocity,
            turn_rate,
            ..*self
        }
    }

    /// Updates the state with a pose measured `dt_s` (above 0) after the one before; `bandwidth` is
    /// `ω`, rad/s.
    pub fn take(&mut self, measured: &Pose<World, Base>, dt_s: f64, bandwidth: f64) {
        let predicted = Self {
            position: self.position
                + self.velocity * dt_s
                + self.acceleration * (0.5 * dt_s * dt_s),
            rotation: UnitQuaternion::new(
                self.turn_rate * dt_s + self.turn_acceleration * (0.5 * dt_s * dt_s),
            ) * self.rotation,
            velocity: self.velocity + self.acceleration * dt_s,
            turn_rate: self.turn_rate + self.turn_acceleration * dt_s,
            ..*self
        };
        let theta = (-bandwidth * dt_s).exp();
        let g = 1.0 - theta.powi(3);
        let h = 1.5 * (1.0 - theta * theta) * (1.0 - theta) / dt_s;
        let k = (1.0 - theta).powi(3) / (dt_s * dt_s);
        let off = measured.translation() - predicted.position;
        let turned = (measured.rotation() * predicted.rotation.inverse()).scaled_axis();
        let mut rotation = UnitQuaternion::new(turned * g) * predicted.rotation;
        // Rounding must not accumulate over hours.
        rotation.renormalize();
        *self = Self {
            position: predicted.position + off * g,
            rotation,
            velocity: predicted.velocity + off * h,
            turn_rate: predicted.turn_rate + turned * h,
            acceleration: predicted.acceleration + off * k,
            turn_acceleration: predicted.turn_acceleration + turned * k,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(position: Vector3<f64>, turn: Vector3<f64>) -> Pose<World, Base> {
        Pose::new(position, UnitQuaternion::new(turn))
    }

    #[test]
    fn a_constant_acceleration_leaves_no_lag() {
        let a = Vector3::new(0.02, -0.01, 0.0);
        let w = Vector3::new(0.0, 0.0, 0.05);
        let mut filter = PoseFilter::at_rest(&pose(Vector3::zeros(), Vector3::zeros()));
        for i in 1..=200 {
            let t = 0.02 * f64::from(i);
            filter.take(&pose(a * (0.5 * t * t), w * t), 0.02, 8.0);
        }
        assert!((filter.velocity - a * 4.0).norm() < 1e-6);
        assert!((filter.turn_rate - w).norm() < 1e-6);
        let later = filter.after(0.05, 0.2);
        assert!((later.position - a * (0.5 * 4.05 * 4.05)).norm() < 1e-6);
        assert!((later.rotation.scaled_axis() - w * 4.05).norm() < 1e-6);
    }

    #[test]
    fn the_velocity_decays_without_measurements() {
        let mut filter = PoseFilter::at_rest(&pose(Vector3::zeros(), Vector3::zeros()));
        filter.velocity = Vector3::x() * 0.02;
        let known = filter.after(0.2, 0.2);
        assert!((known.position.x - 0.004).abs() < 1e-12);
        assert_eq!(known.velocity.x, 0.02);
        let long = filter.after(60.0, 0.2);
        assert!((long.position.x - 0.02 * (0.2 + VELOCITY_FADES_S)).abs() < 1e-12);
        assert!(long.velocity.norm() < 1e-12);
        // One long step and many short ones cover the same distance.
        let step = (filter.after(0.5, 0.2).position - filter.after(0.492, 0.2).position).norm();
        assert!(step < 0.02 * 0.008);
    }
}
