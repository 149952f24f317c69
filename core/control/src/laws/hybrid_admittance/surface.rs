//! The controller's model of the surface: the normal in use and how it turns along the path.
//!
//! Called by the controller each cycle. The normal moves with the surface's curvature and towards
//! the estimate, at a bounded rate. A switch of estimators, an outlier or a late packet therefore
//! never causes a jerk of the tool.

use nalgebra::{Matrix3, Rotation3, Vector3};
use tangent_estimation::NormalEstimate;

use super::config::NormalConfig;
use crate::contact::alignment::{angle_between, any_perpendicular, tangential};
use crate::inputs::EstimateInput;
use crate::limits::clamp_norm;

/// Minimum speed at which a direction of travel is defined for learning the curvature, m/s.
const SPEED_MIN: f64 = 0.002;

/// Model of the surface.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Normal in use: unit, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// The normal from estimates alone. It is in use where nothing is learnt.
    pub estimated: Vector3<f64>,
    /// Normal that earlier passes learnt of the place under the tool, and its weight, 0 to 1: for
    /// the next cycle.
    pub learnt: Option<(Vector3<f64>, f64)>,
    /// Angular velocity of the surface normal under the moving tool, rad/s, base axes: the
    /// feed-forward of eq. (4).
    pub turn_rate: Vector3<f64>,
    /// Shape operator in use, 1/m, base axes: the last one from an estimator, or learnt from the
    /// rotation of the normal for estimators that give none.
    shape: Matrix3<f64>,
}

impl Surface {
    /// A flat surface with this `normal`.
    pub fn new(normal: Vector3<f64>) -> Self {
        Self {
            normal,
            estimated: normal,
            learnt: None,
            turn_rate: Vector3::zeros(),
            shape: Matrix3::zeros(),
        }
    }

    /// Processes one cycle: the tool moves with `velocity` (m/s, base axes); `input` is a usable
    /// estimate with its age, or `None`.
    pub fn step(
        &mut self,
        config: &NormalConfig,
        input: Option<&EstimateInput>,
        velocity: &Vector3<f64>,
        dt_s: f64,
    ) {
        let along = tangential(velocity, &self.estimated);
        let given = input
            .and_then(|i| i.estimate.curvature)
            .filter(|curvature| curvature.norm() <= config.curvature_max_per_m);
        if let Some(curvature) = given {
            self.shape = curvature;
        } else if input.is_none() {
            // The known curvature is valid only over a short distance.
            self.shape *= 1.0 - (along.norm() * dt_s / config.curvature_distance_m).min(1.0);
        }
        // The normal's derivative is the shape operator times the velocity; its angular velocity is
        // n × n'.
        let turning = self.estimated.cross(&(self.shape * along));
        self.turn_rate = clamp_norm(turning, config.turn_rate_max_rad_per_s);
        let correction = input.map_or_else(Vector3::zeros, |input| {
            let foresight_s = self.foresight_s(config, input.age_s, &along, given);
            let now = self.rotation_within(config, foresight_s) * input.estimate.normal;
            rotation_to(&self.estimated, &now) / Self::filter_s(config, &input.estimate).max(dt_s)
        });
        let rate = clamp_norm(self.turn_rate + correction, config.turn_rate_max_rad_per_s);
        if input.is_some_and(|i| i.estimate.curvature.is_none()) {
            self.learn(config, &correction, &along, dt_s);
        }
        let turned = Rotation3::new(rate * dt_s);
        self.estimated = (turned * self.estimated).normalize();
        self.follow(config.turn_rate_max_rad_per_s * dt_s);
        // The shape operator rotates with the tangent plane.
        self.shape = turned * self.shape * turned.inverse();
    }

    /// Rotation of the surface under the moving tool within `time_s`, base axes.
    pub fn rotation_within(&self, config: &NormalConfig, time_s: f64) -> Rotation3<f64> {
        let turned = self.turn_rate * time_s;
        Rotation3::new(clamp_norm(turned, config.prediction_max_rad))
    }

    /// Turns the normal in use, by at most `turn_max_rad`, towards the estimated one, or as far
    /// from it as what is learnt has weight.
    fn follow(&mut self, turn_max_rad: f64) {
        let learnt = self.learnt.take();
        let wanted = learnt
            .and_then(|(normal, weight)| self.estimated.lerp(&normal, weight).try_normalize(0.1))
            .unwrap_or(self.estimated);
        let way = rotation_to(&self.normal, &wanted);
        self.normal = if way.norm() <= turn_max_rad * (1.0 + 1e-6) + 1e-12 {
            wanted
        } else {
            (Rotation3::new(clamp_norm(way, turn_max_rad)) * self.normal).normalize()
        };
    }

    /// Time by which an old estimate is moved on along the surface, s: its age. A learnt shape
    /// depends on the very rotation that it predicts, and would diverge if the age exceeded the
    /// learning time. For such a shape the limit is half of that time.
    fn foresight_s(
        &self,
        config: &NormalConfig,
        age_s: f64,
        along: &Vector3<f64>,
        given: Option<Matrix3<f64>>,
    ) -> f64 {
        let speed = along.norm();
        if given.is_some() || speed < SPEED_MIN {
            return age_s.max(0.0);
        }
        age_s.clamp(0.0, 0.5 * config.curvature_distance_m / speed)
    }

    /// Time constant of the low-pass filter, s: longer for an estimate with a large variance (while
    /// standing on friction, for instance).
    fn filter_s(config: &NormalConfig, estimate: &NormalEstimate) -> f64 {
        let variance = 0.5 * estimate.covariance.trace();
        if !(variance.is_finite() && variance > 0.0) || config.sure_rad <= 0.0 {
            return config.filter_s;
        }
        config.filter_s * (1.0 + variance / (config.sure_rad * config.sure_rad))
    }

    /// Corrects the curvature by the rotation that it did not predict, over a distance of
    /// `curvature_distance_m`.
    fn learn(
        &mut self,
        config: &NormalConfig,
        correction: &Vector3<f64>,
        along: &Vector3<f64>,
        dt_s: f64,
    ) {
        let speed = along.norm();
        if speed < SPEED_MIN {
            return;
        }
        let unforeseen =
            clamp_norm(*correction, config.turn_rate_max_rad_per_s).cross(&self.estimated);
        let direction = along / speed;
        let step = unforeseen * direction.transpose() * (dt_s / config.curvature_distance_m);
        self.shape += (step + step.transpose()) * 0.5;
        let norm = self.shape.norm();
        if norm > config.curvature_max_per_m {
            self.shape *= config.curvature_max_per_m / norm;
        }
    }
}

/// Rotation vector from unit vector `from` to unit vector `to`, rad.
fn rotation_to(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    let cross = from.cross(to);
    let sine = cross.norm();
    if sine < 1e-12 {
        if from.dot(to) > 0.0 {
            return Vector3::zeros();
        }
        return any_perpendicular(from) * std::f64::consts::PI;
    }
    cross * (angle_between(from, to) / sine)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tangent_mechanics::Pose;
    use tangent_sensing::Validity;

    fn estimate(normal: Vector3<f64>, curvature: Option<Matrix3<f64>>) -> EstimateInput {
        let mut estimate = NormalEstimate::invalid(&Pose::identity(), Validity::Valid);
        estimate.normal = normal;
        estimate.covariance = Matrix3::zeros();
        estimate.curvature = curvature;
        EstimateInput {
            estimate,
            age_s: 0.0,
        }
    }

    proptest! {
        #[test]
        fn turns_at_a_bounded_rate_whatever_the_estimate(normals in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 1..60),
                                                         v in prop::array::uniform3(-0.3f64..0.3), k in -60.0f64..60.0) {
            let config = NormalConfig::default();
            let mut surface = Surface::new(Vector3::z());
            let dt = 0.008;
            for n in normals {
                let n = Vector3::from(n);
                prop_assume!(n.norm() > 1e-3);
                let before = surface.normal;
                surface.step(&config, Some(&estimate(n.normalize(), Some(Matrix3::identity() * k))), &Vector3::from(v), dt);
                prop_assert!((surface.normal.norm() - 1.0).abs() < 1e-12);
                prop_assert!(angle_between(&before, &surface.normal) <= config.turn_rate_max_rad_per_s * dt + 1e-9);
                prop_assert!(surface.turn_rate.norm() <= config.turn_rate_max_rad_per_s + 1e-9);
            }
        }
    }

    /// Along a cylinder of 0.25 m at 0.02 m/s the normal in use stays on the true one once the
    /// curvature is known.
    #[test]
    fn curvature_given_or_learnt_leaves_no_lag() {
        let (radius, speed, dt) = (0.25, 0.02, 0.008);
        for given in [true, false] {
            let config = NormalConfig::default();
            let mut surface = Surface::new(Vector3::z());
            let mut error = 0.0;
            let mut t = 0.0;
            while t < 8.0 {
                let angle = speed * t / radius;
                let truth = Rotation3::new(Vector3::y() * angle) * Vector3::z();
                let direction = Rotation3::new(Vector3::y() * angle) * Vector3::x();
                let shape = direction * direction.transpose() / radius;
                let e = estimate(truth, given.then_some(shape));
                surface.step(&config, Some(&e), &(direction * speed), dt);
                error = angle_between(&surface.normal, &truth);
                t += dt;
            }
            assert!(error < 1e-3, "{given}: {error}");
            let ratio = surface.turn_rate.norm() / (speed / radius);
            assert!((ratio - 1.0).abs() < 0.01, "{given}: {ratio}");
        }
    }

    /// Largest error in the last second of the normal in use on a cylinder of 0.25 m, at `speed`,
    /// with estimates `age_s` old, rad.
    fn lag_rad(config: &NormalConfig, speed: f64, age_s: f64, given: bool) -> f64 {
        let (radius, dt) = (0.25, 0.008);
        let at = |t: f64| Rotation3::new(Vector3::y() * (speed * t / radius));
        let mut surface = Surface::new(Vector3::z());
        let mut worst: f64 = 0.0;
        for cycle in 0..1000 {
            let t = f64::from(cycle) * dt;
            let direction = at(t) * Vector3::x();
            let seen = at((t - age_s).max(0.0));
            let along = seen * Vector3::x();
            let shape = along * along.transpose() / radius;
            let input = EstimateInput {
                age_s,
                ..estimate(seen * Vector3::z(), given.then_some(shape))
            };
            surface.step(config, Some(&input), &(direction * speed), dt);
            if t > 7.0 {
                worst = worst.max(angle_between(&surface.normal, &(at(t + dt) * Vector3::z())));
            }
        }
        worst
    }

    #[test]
    fn an_old_estimate_is_moved_on_along_the_surface() {
        let config = NormalConfig::default();
        let blind = NormalConfig {
            prediction_max_rad: 0.0,
            ..config
        };
        for given in [true, false] {
            for speed in [0.02, 0.05, 0.1] {
                for age_s in [0.0, 0.02, 0.06, 0.09] {
                    let turn = speed * age_s / 0.25;
                    let (with, without) = (
                        lag_rad(&config, speed, age_s, given),
                        lag_rad(&blind, speed, age_s, given),
                    );
                    assert!(
                        (without - turn).abs() < 1e-3 + 0.1 * turn,
                        "{without} {turn}"
                    );
                    let least = if given { 0.05 } else { 0.25 };
                    assert!(
                        with < 1e-3 + least * turn,
                        "{given} {speed} m/s {age_s} s: {with} of {turn}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_is_foretold_is_bounded() {
        let config = NormalConfig::default();
        let mut surface = Surface::new(Vector3::z());
        let input = EstimateInput {
            age_s: 0.1,
            ..estimate(Vector3::z(), Some(Matrix3::identity() * 50.0))
        };
        for _ in 0..10_000 {
            surface.step(&config, Some(&input), &Vector3::zeros(), 0.008);
        }
        assert!(angle_between(&surface.normal, &Vector3::z()) < 1e-9);
        let fast = Vector3::x() * 0.25;
        let mut most: f64 = 0.0;
        for _ in 0..1000 {
            surface.step(&config, Some(&input), &fast, 0.008);
            most = most.max(angle_between(&surface.normal, &Vector3::z()));
        }
        // Due to the low-pass filter, the curvature moves the normal slightly beyond the predicted
        // target.
        let carried = config.turn_rate_max_rad_per_s * config.filter_s;
        assert!(most < config.prediction_max_rad + 1.1 * carried, "{most}");
    }

    #[test]
    fn without_an_estimate_the_last_shape_carries_on_for_a_short_way() {
        let config = NormalConfig::default();
        let mut surface = Surface::new(Vector3::z());
        let shape = Matrix3::new(4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let input = estimate(Vector3::z(), Some(shape));
        surface.step(&config, Some(&input), &Vector3::zeros(), 0.008);
        let velocity = Vector3::x() * 0.02;
        for _ in 0..5000 {
            surface.step(&config, None, &velocity, 0.008);
        }
        let turned = angle_between(&surface.normal, &Vector3::z());
        let way = config.curvature_distance_m;
        assert!(turned > 0.5 * 4.0 * way && turned < 4.0 * way, "{turned}");
    }

    #[test]
    fn without_an_estimate_and_standing_still_nothing_turns() {
        let mut surface = Surface::new(Vector3::z());
        surface.step(&NormalConfig::default(), None, &Vector3::zeros(), 0.008);
        assert_eq!(surface.normal, Vector3::z());
    }
}
