//! The surface as the controller believes it: the normal in use and how it turns along the way.
//!
//! Called by the controller each cycle. The normal moves with the surface's curvature and towards the estimate, at a
//! bounded rate; so a switch of estimators, an outlier or a late packet never jerks the tool.

use nalgebra::{Matrix3, Rotation3, Vector3};
use tangent_estimation::NormalEstimate;

use crate::NormalConfig;
use crate::alignment::{angle_between, any_perpendicular, tangential};
use crate::limits::clamp_norm;

/// Least speed at which a direction of travel exists for learning the curvature, m/s.
const SPEED_MIN: f64 = 0.002;

/// The surface as believed.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Normal in use: unit, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Rate at which the surface turns under the moving tool, rad/s, base axes: the feed-forward of eq. (4).
    pub turn_rate: Vector3<f64>,
    /// Shape operator learnt from the normal's own turning, 1/m, base axes; for estimators that give none.
    learnt: Matrix3<f64>,
}

impl Surface {
    /// Facing `normal`, flat.
    pub fn new(normal: Vector3<f64>) -> Self {
        Self {
            normal,
            turn_rate: Vector3::zeros(),
            learnt: Matrix3::zeros(),
        }
    }

    /// One cycle: the tool moves with `velocity` (m/s, base axes); `estimate` is a usable one or none.
    pub fn step(
        &mut self,
        config: &NormalConfig,
        estimate: Option<&NormalEstimate>,
        velocity: &Vector3<f64>,
        dt_s: f64,
    ) {
        let along = tangential(velocity, &self.normal);
        let shape = match estimate.and_then(|e| e.curvature) {
            Some(curvature) if curvature.norm() <= config.curvature_max_per_m => curvature,
            _ => self.learnt,
        };
        // The normal's derivative is the shape operator times the velocity; what turns it is n × n'.
        self.turn_rate = clamp_norm(
            self.normal.cross(&(shape * along)),
            config.turn_rate_max_rad_per_s,
        );
        let correction = estimate.map_or_else(Vector3::zeros, |estimate| {
            rotation_to(&self.normal, &estimate.normal) / Self::filter_s(config, estimate).max(dt_s)
        });
        let rate = clamp_norm(self.turn_rate + correction, config.turn_rate_max_rad_per_s);
        if estimate.is_some_and(|e| e.curvature.is_none()) {
            self.learn(config, &correction, &along, dt_s);
        }
        let turned = Rotation3::new(rate * dt_s);
        self.normal = (turned * self.normal).normalize();
        // What was learnt goes along with the tangent plane.
        self.learnt = turned * self.learnt * turned.inverse();
    }

    /// The low pass, slower for an estimate that is unsure of itself (standing on friction, for instance).
    fn filter_s(config: &NormalConfig, estimate: &NormalEstimate) -> f64 {
        let variance = 0.5 * estimate.covariance.trace();
        if !(variance.is_finite() && variance > 0.0) || config.sure_rad <= 0.0 {
            return config.filter_s;
        }
        config.filter_s * (1.0 + variance / (config.sure_rad * config.sure_rad))
    }

    /// Turning that the curvature did not foresee corrects it, over a way of `curvature_distance_m`.
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
            clamp_norm(*correction, config.turn_rate_max_rad_per_s).cross(&self.normal);
        let direction = along / speed;
        let step = unforeseen * direction.transpose() * (dt_s / config.curvature_distance_m);
        self.learnt += (step + step.transpose()) * 0.5;
        let norm = self.learnt.norm();
        if norm > config.curvature_max_per_m {
            self.learnt *= config.curvature_max_per_m / norm;
        }
    }
}

/// Rotation vector that takes unit vector `from` to unit vector `to`, rad.
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

    fn estimate(normal: Vector3<f64>, curvature: Option<Matrix3<f64>>) -> NormalEstimate {
        let mut e = NormalEstimate::invalid(&Pose::identity(), Validity::Valid);
        e.normal = normal;
        e.covariance = Matrix3::zeros();
        e.curvature = curvature;
        e
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

    /// Along a cylinder of 0.25 m at 0.02 m/s the normal in use stays on the true one once the curvature is known.
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

    #[test]
    fn without_an_estimate_and_standing_still_nothing_turns() {
        let mut surface = Surface::new(Vector3::z());
        surface.step(&NormalConfig::default(), None, &Vector3::zeros(), 0.008);
        assert_eq!(surface.normal, Vector3::z());
    }
}
