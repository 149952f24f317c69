//! Desired orientation of the tool from the normal in use: eqs. (22)-(29), and in addition a
//! feed-forward of the surface's rotation under the tool.
//!
//! The paper's n_s points along the tool's axis, into the surface; the project's normal points out
//! of it. Hence r_z' = -n here.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::config::OrientationConfig;
use super::fused_normal::NormalInUse;
use crate::limits::clamp_norm;

/// Time constant with which the arm's reference follows R_input, s: with eq. (29) alone, the rate
/// would have a step at every frame.
const INPUT_S: f64 = 0.04;
/// Lag of the feed-forward, s.
const TURNING_S: f64 = 0.03;

/// R_ee,d of eqs. (24)-(27): square to the surface, its x axis as near to the present one as
/// possible. `None` if that axis is along the normal.
pub(super) fn square_to(
    normal: &Vector3<f64>,
    present: &UnitQuaternion<f64>,
) -> Option<UnitQuaternion<f64>> {
    let z = -normal;
    let x = present * Vector3::x();
    let across = x - z * z.dot(&x);
    let size = across.norm();
    if size < 0.05 {
        return None;
    }
    let x = across / size;
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    Some(UnitQuaternion::from_rotation_matrix(
        &Rotation3::from_matrix_unchecked(axes),
    ))
}

/// The reference orientation and its rate.
#[derive(Clone, Copy, Debug)]
pub(super) struct OrientationReference {
    /// R_input of eq. (29).
    pub rotation: UnitQuaternion<f64>,
    /// Angular velocity, base axes, rad/s.
    pub angular: Vector3<f64>,
    /// Part of the angular velocity that follows the normal; the rest is feed-forward.
    correction: Vector3<f64>,
    turning: Vector3<f64>,
    /// State of the published filter: start, target, and elapsed time, s.
    filter: Option<(UnitQuaternion<f64>, UnitQuaternion<f64>, f64)>,
    last_normal: Option<Vector3<f64>>,
}

impl OrientationReference {
    pub fn new(rotation: UnitQuaternion<f64>) -> Self {
        Self {
            rotation,
            angular: Vector3::zeros(),
            correction: Vector3::zeros(),
            turning: Vector3::zeros(),
            filter: None,
            last_normal: None,
        }
    }

    /// Advances one period towards the normal in use, with the tool at `present` and moving at
    /// `velocity` (m/s).
    pub fn step(
        &mut self,
        config: &OrientationConfig,
        surface: &NormalInUse,
        present: &UnitQuaternion<f64>,
        velocity: &Vector3<f64>,
        dt_s: f64,
    ) {
        let most = config.turn_rate_max_rad_per_s;
        let normal = &surface.normal;
        // The rate itself must be continuous: a jump in a frame turns the tool without a jerk.
        let (turning, wanted, lag_s) = if config.feed_forward {
            let n = self.normal();
            let across = velocity - n * n.dot(velocity);
            // Position of the tool after the lag of the filter below.
            let coming = across * TURNING_S;
            let curvature = surface
                .change
                .map_or(surface.curvature, |c| c.after(&surface.curvature, &coming));
            let turning = clamp_norm(n.cross(&(curvature * across)), most);
            // A curvature that appears, disappears or jumps with its frame must not make the rate
            // jump.
            let share = dt_s / (TURNING_S + dt_s);
            self.turning += (turning - self.turning) * share;
            (
                self.turning,
                self.away(normal) / config.follow_s,
                0.5 * config.follow_s,
            )
        } else {
            let input = self.filtered(config, normal, present, dt_s);
            let left = (input * self.rotation.inverse()).scaled_axis();
            (Vector3::zeros(), left / INPUT_S, 0.5 * INPUT_S)
        };
        let wanted = clamp_norm(wanted, most);
        let change = (wanted - self.correction) * (dt_s / (lag_s + dt_s));
        self.correction += clamp_norm(change, config.turn_acceleration_max_rad_per_s2 * dt_s);
        self.angular = clamp_norm(turning + self.correction, most);
        self.rotation = UnitQuaternion::from_scaled_axis(self.angular * dt_s) * self.rotation;
    }

    /// The normal to which the reference is square: the one in use, without its jumps.
    pub fn normal(&self) -> Vector3<f64> {
        -(self.rotation * Vector3::z())
    }

    /// Stops the reference.
    pub fn hold(&mut self) {
        self.angular = Vector3::zeros();
        self.correction = Vector3::zeros();
        self.turning = Vector3::zeros();
        self.filter = None;
        self.last_normal = None;
    }

    /// R_input of eq. (29): from the orientation at the last change of the normal to the new one,
    /// over T.
    fn filtered(
        &mut self,
        config: &OrientationConfig,
        normal: &Vector3<f64>,
        present: &UnitQuaternion<f64>,
        dt_s: f64,
    ) -> UnitQuaternion<f64> {
        if self.last_normal != Some(*normal) {
            self.last_normal = Some(*normal);
            if let Some(target) = square_to(normal, present) {
                self.filter = Some((self.rotation, target, 0.0));
            }
        }
        let Some((start, target, since)) = &mut self.filter else {
            return self.rotation;
        };
        *since += dt_s;
        let zeta = (*since / config.follow_s).min(1.0);
        let way = (*target * start.inverse()).scaled_axis();
        UnitQuaternion::from_scaled_axis(way * zeta) * *start
    }

    /// Remaining rotation towards `normal`, rad. Computed from the reference's own x axis, so that
    /// noise does not turn the tool about its axis.
    fn away(&self, normal: &Vector3<f64>) -> Vector3<f64> {
        square_to(normal, &self.rotation).map_or_else(Vector3::zeros, |r| {
            (r * self.rotation.inverse()).scaled_axis()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::UnifiedForceImpedanceConfig;
    use super::super::fused_normal::SurfaceVariation;
    use super::super::interface::BendChange;
    use super::*;
    use crate::parameters::presets::Presets;
    use proptest::prelude::*;
    use tangent_sensing::Validity;

    fn down() -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    }

    fn flat(normal: Vector3<f64>) -> NormalInUse {
        NormalInUse {
            normal,
            covariance: Matrix3::zeros(),
            validity: Validity::Valid,
            curvature: Matrix3::zeros(),
            change: None,
            variation: SurfaceVariation::NotSeen,
        }
    }

    #[test]
    fn the_filter_is_equations_28_and_29() {
        let config = UnifiedForceImpedanceConfig::preset("paper")
            .unwrap()
            .orientation;
        let mut reference = OrientationReference::new(down());
        let n = Vector3::new(0.1, 0.2, 1.0).normalize();
        let target = square_to(&n, &down()).unwrap();
        let whole = down().angle_to(&target);
        let periods = (config.follow_s / 1e-3).round() as i32;
        for i in 1..=periods + 50 {
            let input = reference.filtered(&config, &n, &down(), 1e-3);
            let share = (f64::from(i) / f64::from(periods)).min(1.0);
            assert!(
                (down().angle_to(&input) - share * whole).abs() < 1e-9,
                "{i}"
            );
        }
        let end = reference.filtered(&config, &n, &down(), 1e-3);
        assert!(end.angle_to(&target) < 1e-9);
    }

    #[test]
    fn a_bend_that_comes_is_turned_into_without_lag() {
        let config = OrientationConfig::default();
        let mut worst = [0.0_f64; 2];
        for (known, worst) in [false, true].into_iter().zip(&mut worst) {
            let mut reference = OrientationReference::new(down());
            // The curvature grows by 200 1/m² along the path: 5 1/m more every 25 mm.
            let (growth, speed) = (200.0, 0.08);
            for i in 0..600 {
                let way = speed * f64::from(i) * 1e-3;
                let angle = 0.5 * growth * way * way;
                let n = Vector3::new(0.0, angle.sin(), angle.cos());
                let along = Vector3::new(0.0, angle.cos(), -angle.sin());
                let surface = NormalInUse {
                    curvature: along * along.transpose() * (growth * way),
                    change: known.then_some(BendChange {
                        way: along,
                        per_m2: growth,
                    }),
                    ..flat(n)
                };
                reference.step(&config, &surface, &down(), &(along * speed), 1e-3);
                *worst = worst.max((reference.rotation * Vector3::z()).angle(&-n));
            }
        }
        assert!(worst[1] < 0.3 * worst[0], "{worst:?}");
    }

    proptest! {
        #[test]
        fn the_desired_frame_is_square_and_turns_no_further_than_needed(n in prop::array::uniform3(-1.0f64..1.0)) {
            let n = Vector3::from(n) + Vector3::z() * 1.5;
            let n = n.normalize();
            let r = square_to(&n, &down()).unwrap();
            prop_assert!((r * Vector3::z() + n).norm() < 1e-9);
            prop_assert!((r.to_rotation_matrix().matrix().determinant() - 1.0).abs() < 1e-9);
            let before = down() * Vector3::x();
            prop_assert!((r * Vector3::x()).dot(&before) > 0.0);
        }
    }

    #[test]
    fn the_published_filter_arrives_after_its_time_and_without_a_step() {
        let config = UnifiedForceImpedanceConfig::preset("paper")
            .unwrap()
            .orientation;
        let mut reference = OrientationReference::new(down());
        let n = Vector3::new(0.05, 0.03, 1.0).normalize();
        let zero = Vector3::zeros();
        let mut last = reference.angular;
        for i in 0..700 {
            reference.step(&config, &flat(n), &down(), &zero, 1e-3);
            let step = (reference.angular - last).norm();
            assert!(
                step <= config.turn_acceleration_max_rad_per_s2 * 1e-3 + 1e-12,
                "{i}: {step}"
            );
            last = reference.angular;
            assert!(last.norm() <= config.turn_rate_max_rad_per_s + 1e-9);
        }
        let left = (reference.rotation * Vector3::z()).angle(&-n);
        assert!(left < 2e-3, "{left}");
    }

    #[test]
    fn on_a_curve_the_reference_does_not_lag() {
        let config = OrientationConfig::default();
        let mut reference = OrientationReference::new(down());
        let bend = Matrix3::from_diagonal(&Vector3::new(0.0, 5.0, 0.0));
        let velocity = Vector3::new(0.0, 0.08, 0.0);
        let mut worst = 0.0_f64;
        for i in 0..2500 {
            let angle = 5.0 * 0.08 * f64::from(i + 1) * 1e-3;
            let n = Vector3::new(0.0, angle.sin(), angle.cos());
            let along = Vector3::new(0.0, angle.cos(), -angle.sin());
            let axis = along * along.transpose() * bend.m22;
            reference.step(
                &config,
                &NormalInUse {
                    curvature: axis,
                    ..flat(n)
                },
                &down(),
                &(along * velocity.norm()),
                1e-3,
            );
            if i > 1500 {
                worst = worst.max((reference.rotation * Vector3::z()).angle(&-n));
            }
        }
        assert!(worst < 0.002, "{worst}");
    }

    #[test]
    fn a_jump_of_the_normal_is_no_jump_of_the_reference() {
        let config = OrientationConfig::default();
        let mut reference = OrientationReference::new(down());
        let n = Vector3::new(0.6, 0.0, 0.8);
        for _ in 0..100 {
            let before = reference.rotation;
            reference.step(&config, &flat(n), &down(), &Vector3::zeros(), 1e-3);
            assert!(before.angle_to(&reference.rotation) <= 0.8e-3 + 1e-9);
        }
    }
}
