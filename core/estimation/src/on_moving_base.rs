//! Estimation on a moving base: samples are converted from base axes to world axes, estimates back
//! to base axes.
//!
//! Wraps every estimator that the registry creates. The surface rests in the world, so the windows,
//! maps and filter states of an estimator are in world axes: in base axes, any motion of the
//! platform would blur them. Without a base motion, the world coincides with the base, and no
//! number changes. Once a pose of the base has been received, every sample has a base motion,
//! however old that pose is.

use nalgebra::Matrix3;
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, World};
use tangent_sensing::{BaseMotion, BaseTrouble, Validity};

use crate::world_estimator::{WorldEstimate, WorldEstimator, WorldSample};
use crate::{ContactSample, NormalEstimate, NormalEstimator};

/// Estimator for samples in base axes, whose state is kept in world axes.
pub(crate) struct OnMovingBase {
    inner: Box<dyn WorldEstimator>,
}

impl OnMovingBase {
    pub fn new(inner: Box<dyn WorldEstimator>) -> Self {
        Self { inner }
    }
}

/// Bound on the distance of a platform from its world's origin, m: the diameter of the earth.
const FARTHEST_M: f64 = 1.3e7;
/// Bound on the speed of a platform, m/s and rad/s.
const FASTEST: f64 = 1e4;

/// The sample in world axes. If the motion of the base is not known, the wrench is marked as
/// unusable for that reason.
fn to_world(sample: &ContactSample, base: &BaseMotion) -> WorldSample {
    let moved =
        |twist: &Twist<Aligned<Tool, Base>>| base.over_ground(&sample.base_from_tool, twist);
    let wrench_validity = if base.trouble.is_some() && sample.wrench_validity.is_valid() {
        Validity::BaseUnknown
    } else {
        sample.wrench_validity
    };
    WorldSample {
        world_from_tool: base.world_from_base * sample.base_from_tool,
        twist: moved(&sample.twist),
        twist_commanded: moved(&sample.twist_commanded),
        wrench_validity,
        base_moves: true,
        ..on_fixed_base(sample)
    }
}

/// The sample in the axes of a world that coincides with the base.
fn on_fixed_base(sample: &ContactSample) -> WorldSample {
    let in_world = |twist: &Twist<Aligned<Tool, Base>>| Twist::new(twist.linear, twist.angular);
    WorldSample {
        time_s: sample.time_s,
        dt_s: sample.dt_s,
        world_from_tool: Pose::from_isometry(*sample.base_from_tool.isometry()),
        twist: in_world(&sample.twist),
        twist_commanded: in_world(&sample.twist_commanded),
        wrench: sample.wrench,
        wrench_delay_s: sample.wrench_delay_s,
        wrench_validity: sample.wrench_validity,
        wrench_bias_age_s: sample.wrench_bias_age_s,
        base_moves: false,
    }
}

/// The estimate in base axes.
fn to_base(estimate: &WorldEstimate, base_from_world: &Pose<Base, World>) -> NormalEstimate {
    let rotation = base_from_world.rotation().to_rotation_matrix().into_inner();
    let turned = |m: &Matrix3<f64>| {
        let t = rotation * m * rotation.transpose();
        // Exactly symmetric, so that readers can compare entries.
        (t + t.transpose()) * 0.5
    };
    NormalEstimate {
        point: (*base_from_world * estimate.point).coordinates(),
        normal: (*base_from_world * estimate.normal).components(),
        covariance: turned(&estimate.covariance),
        curvature: estimate.curvature.as_ref().map(turned),
        validity: estimate.validity,
        friction: estimate.friction,
    }
}

/// The estimate in the axes of a base that coincides with the world.
fn to_fixed_base(estimate: &WorldEstimate) -> NormalEstimate {
    NormalEstimate {
        point: estimate.point.coordinates(),
        normal: estimate.normal_vector(),
        covariance: estimate.covariance,
        validity: estimate.validity,
        friction: estimate.friction,
        curvature: estimate.curvature,
    }
}

/// Whether all numbers are finite, and small enough that results computed from them are finite too.
fn is_sane(base: &BaseMotion) -> bool {
    base.is_finite()
        && base.world_from_base.translation().amax() < FARTHEST_M
        && base.twist.vector().amax() < FASTEST
}

impl NormalEstimator for OnMovingBase {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn update(&mut self, sample: &ContactSample) -> NormalEstimate {
        let Some(base) = &sample.base else {
            return to_fixed_base(&self.inner.update(&on_fixed_base(sample)));
        };
        let unusable = BaseMotion {
            trouble: Some(BaseTrouble::NotFinite),
            ..BaseMotion::still()
        };
        let base = if is_sane(base) { base } else { &unusable };
        let estimate = self.inner.update(&to_world(sample, base));
        to_base(&estimate, &base.world_from_base.inverse())
    }

    fn reset(&mut self) {
        self.inner.reset();
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use tangent_mechanics::{World, Wrench};

    use super::*;
    use crate::{EstimatorConfig, build};

    const DT_S: f64 = 0.008;

    /// A tool that slides over a pipe of 0.25 m: pose, velocity and force in axes of the floor.
    fn on_floor(t: f64) -> (Pose<World, Tool>, Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        let speed = 0.02;
        let way = speed * (t - 1.0).max(0.0);
        let angle = way / 0.25;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
        let normal = turn * Vector3::z();
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let velocity = if t > 1.0 {
            turn * Vector3::x() * speed
        } else {
            Vector3::zeros()
        };
        let slide = velocity.try_normalize(1e-9).unwrap_or_default();
        let force = (normal - slide * 0.3) * if t < 0.3 { 0.0 } else { 3.0 };
        (
            Pose::new(normal * 0.25, turn * down),
            velocity,
            normal,
            force,
        )
    }

    fn sample(t: f64, base: Option<BaseMotion>) -> (ContactSample, Vector3<f64>) {
        let (world_from_tool, velocity, normal, force) = on_floor(t);
        let motion = base.unwrap_or(BaseMotion::still());
        let spin = if t > 1.0 {
            Vector3::y() * (0.02 / 0.25)
        } else {
            Vector3::zeros()
        };
        let base_from_tool: Pose<Base, Tool> = motion.world_from_base.inverse() * world_from_tool;
        let twist = motion.against_base(&base_from_tool, &Twist::new(velocity, spin));
        let sample = ContactSample {
            time_s: t,
            dt_s: DT_S,
            base_from_tool,
            twist,
            twist_commanded: twist,
            wrench: Wrench::new(world_from_tool.unrotate(&force), Vector3::zeros()),
            wrench_delay_s: 0.0,
            wrench_validity: Validity::Valid,
            wrench_bias_age_s: Some(t),
            base,
        };
        (sample, motion.world_from_base.unrotate(&normal))
    }

    /// A platform that turns and translates.
    fn moving(t: f64) -> BaseMotion {
        let turn_rate = Vector3::z() * 0.05;
        let rotation = UnitQuaternion::new(turn_rate * t);
        let velocity = Vector3::new(0.02, -0.015, 0.01);
        let world_from_base = Pose::new(velocity * t, rotation);
        BaseMotion {
            twist: Twist::new(
                world_from_base.unrotate(&velocity),
                world_from_base.unrotate(&turn_rate),
            ),
            world_from_base,
            age_s: 0.0,
            trouble: None,
        }
    }

    /// One contact seen from a base at rest and from a moving one gives the same estimate in axes
    /// of the floor, up to rounding. So no window and no map is blurred.
    #[test]
    fn every_estimator_sees_the_same_surface_from_a_moving_base() {
        for name in crate::estimator_names() {
            let config = EstimatorConfig::default();
            let (mut still, mut moved) =
                (build(name, &config).unwrap(), build(name, &config).unwrap());
            let mut error: f64 = 0.0;
            for i in 1..1500 {
                let t = f64::from(i) * DT_S;
                let base = moving(t);
                let a = still.update(&sample(t, None).0);
                let (seen, normal) = sample(t, Some(base));
                let b = moved.update(&seen);
                let back = &base.world_from_base;
                let apart = (back.rotate(&b.normal) - a.normal).norm();
                assert!(apart < 1e-6, "{name} at {t}: {apart}");
                assert!((back.transform_point(&b.point) - a.point).norm() < 1e-9);
                assert_eq!(a.validity, b.validity, "{name} at {t}");
                error = (b.normal - normal).norm();
            }
            if !name.ends_with("_paper") {
                assert!(error < 0.02, "{name}: {error} rad");
            }
        }
    }

    #[test]
    fn a_base_of_unknown_motion_is_said_and_leaves_no_trace() {
        let config = EstimatorConfig::default();
        let mut estimator = build("blend", &config).unwrap();
        let mut last = None;
        for i in 1..700 {
            let t = f64::from(i) * DT_S;
            let mut base = moving(t);
            if i > 600 {
                base.trouble = Some(BaseTrouble::Silent);
            }
            let estimate = estimator.update(&sample(t, Some(base)).0);
            let expected = if i > 600 {
                Validity::BaseUnknown
            } else {
                estimate.validity
            };
            assert_eq!(estimate.validity, expected);
            let on_floor = base.world_from_base.rotate(&estimate.normal);
            if let Some(held) = last.filter(|_| i > 601) {
                let held: Vector3<f64> = held;
                assert!((on_floor - held).norm() < 1e-9);
            }
            last = Some(on_floor);
        }
    }
}
