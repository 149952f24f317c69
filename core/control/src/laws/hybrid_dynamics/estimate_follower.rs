//! The object pose in use: it follows the estimate smoothly, so that a jump of the estimate (the
//! first touch corrects it by centimetres) does not become a jump of the reference.

use nalgebra::{UnitQuaternion, Vector3};
use tangent_mechanics::{Base, Object, Pose};

use super::EstimateUseConfig;
use crate::limits::clamp_norm;

/// Pose in use and its velocity.
#[derive(Clone, Copy, Debug)]
pub(super) struct EstimateFollower {
    pose: Pose<Base, Object>,
    /// Velocity of the pivot, m/s.
    linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    angular: Vector3<f64>,
}

impl EstimateFollower {
    pub fn new(pose: Pose<Base, Object>) -> Self {
        Self {
            pose,
            linear: Vector3::zeros(),
            angular: Vector3::zeros(),
        }
    }

    pub fn pose(&self) -> &Pose<Base, Object> {
        &self.pose
    }

    /// Stops the pose in use, at its maximum deceleration, when there is no new estimate.
    pub fn hold(&mut self, config: &EstimateUseConfig, dt_s: f64) {
        let share = if config.follow_s > 0.0 {
            (dt_s / config.follow_s).min(1.0)
        } else {
            1.0
        };
        self.linear *= 1.0 - share;
        self.angular *= 1.0 - share;
    }

    /// Advances one period towards `estimate`. `pivot` (object axes, m) is the point whose motion
    /// is limited: the one under the tool, not the object's distant origin.
    pub fn step(
        &mut self,
        config: &EstimateUseConfig,
        estimate: &Pose<Base, Object>,
        pivot: &Vector3<f64>,
        dt_s: f64,
    ) {
        if config.follow_s <= 0.0 {
            *self = Self::new(*estimate);
            return;
        }
        let at = self.pose.transform_point(pivot);
        let away = estimate.transform_point(pivot) - at;
        let turn = (estimate.rotation() * self.pose.rotation().inverse()).scaled_axis();
        // Critically damped, in the exact form of one step: stable for any period.
        let rate = 2.0 / config.follow_s;
        let x = rate * dt_s;
        let decay = 1.0 / (1.0 + x + 0.48 * x * x + 0.235 * x * x * x);
        let follow = |speed: &mut Vector3<f64>, error: Vector3<f64>, limit: f64| {
            let towards = clamp_norm(error, limit * config.follow_s);
            let temporary = (*speed - towards * rate) * dt_s;
            let after = (*speed - temporary * rate) * decay;
            let moved = towards - (towards - temporary) * decay;
            *speed = after;
            moved
        };
        let moved = follow(&mut self.linear, away, config.speed_max_m_per_s);
        let turned = follow(&mut self.angular, turn, config.turn_rate_max_rad_per_s);
        let rotation = UnitQuaternion::from_scaled_axis(turned) * self.pose.rotation();
        self.pose = Pose::new(at + moved - rotation * pivot, rotation);
    }

    /// Velocity (base axes, m/s) of `point` (object axes, m), a point of the pose in use; `pivot`
    /// as in [`Self::step`].
    pub fn velocity_at(&self, point: &Vector3<f64>, pivot: &Vector3<f64>) -> Vector3<f64> {
        self.linear + self.angular.cross(&self.pose.rotate(&(point - pivot)))
    }

    pub fn angular(&self) -> Vector3<f64> {
        self.angular
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_followed_smoothly_within_the_speeds_and_to_the_end() {
        let config = EstimateUseConfig::default();
        let pivot = Vector3::new(-0.17, 0.02, 0.0);
        let mut follower = EstimateFollower::new(Pose::identity());
        let target = Pose::new(
            Vector3::new(0.004, -0.01, 0.015),
            UnitQuaternion::from_scaled_axis(Vector3::new(0.03, -0.05, 0.01)),
        );
        let (dt, mut before, mut speed_before) = (1e-3, pivot, Vector3::zeros());
        for _ in 0..2000 {
            follower.step(&config, &target, &pivot, dt);
            let at = follower.pose().transform_point(&pivot);
            let speed = (at - before) / dt;
            assert!(
                speed.norm() <= config.speed_max_m_per_s * 1.01,
                "{}",
                speed.norm()
            );
            assert!(
                (speed - speed_before).norm() / dt
                    < 4.0 * config.speed_max_m_per_s / config.follow_s
            );
            assert!((speed - follower.velocity_at(&pivot, &pivot)).norm() < 2e-3);
            (before, speed_before) = (at, speed);
        }
        assert!((follower.pose().matrix() - target.matrix()).amax() < 1e-9);
    }

    #[test]
    fn without_a_time_constant_it_is_the_estimate() {
        let config = EstimateUseConfig {
            follow_s: 0.0,
            ..EstimateUseConfig::default()
        };
        let target = Pose::new(Vector3::x(), UnitQuaternion::identity());
        let mut follower = EstimateFollower::new(Pose::identity());
        follower.step(&config, &target, &Vector3::zeros(), 1e-3);
        assert_eq!(*follower.pose(), target);
    }
}
