//! Estimation on a moving base: samples are converted to axes of the floor, estimates back to axes
//! of the base.
//!
//! Wraps every estimator that the registry creates. The surface is fixed to the floor, so windows,
//! maps and filter states must be as well: in base axes, any motion of the platform would blur
//! them. An estimator knows one frame that the surface is fixed to, and calls it base. On a moving
//! base it is given the floor's axes instead. Samples without a base motion pass through unchanged.
//! Once a pose of the base has been received, every sample has a base motion, however old that pose
//! is.

use nalgebra::Matrix3;
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist};
use tangent_sensing::{BaseMotion, BaseTrouble, Validity};

use crate::{ContactSample, NormalEstimate, NormalEstimator};

/// Estimator whose state is kept in axes of the floor.
pub(crate) struct OnMovingBase {
    inner: Box<dyn NormalEstimator>,
}

impl OnMovingBase {
    pub fn new(inner: Box<dyn NormalEstimator>) -> Self {
        Self { inner }
    }
}

/// Bound on the distance of a platform from its world's origin, m: the diameter of the earth.
const FARTHEST_M: f64 = 1.3e7;
/// Bound on the speed of a platform, m/s and rad/s.
const FASTEST: f64 = 1e4;

/// The sample in axes of the floor. If the motion of the base is not known, the wrench is marked as
/// unusable for that reason.
fn to_floor(sample: &ContactSample, base: &BaseMotion) -> ContactSample {
    let moved = |twist: &Twist<Aligned<Tool, Base>>| {
        let twist = base.over_ground(&sample.base_from_tool, twist);
        Twist::new(twist.linear, twist.angular)
    };
    ContactSample {
        base_from_tool: Pose::from_isometry(
            *(base.world_from_base * sample.base_from_tool).isometry(),
        ),
        twist: moved(&sample.twist),
        twist_commanded: moved(&sample.twist_commanded),
        wrench_validity: if base.trouble.is_some() && sample.wrench_validity.is_valid() {
            Validity::BaseUnknown
        } else {
            sample.wrench_validity
        },
        base: None,
        ..*sample
    }
}

fn to_base(estimate: &NormalEstimate, base: &BaseMotion) -> NormalEstimate {
    let pose = base.world_from_base.inverse();
    let rotation = pose.rotation().to_rotation_matrix().into_inner();
    let turned = |m: &Matrix3<f64>| {
        let t = rotation * m * rotation.transpose();
        // Exactly symmetric, so that readers can compare entries.
        (t + t.transpose()) * 0.5
    };
    NormalEstimate {
        point: pose.transform_point(&estimate.point),
        normal: pose.rotate(&estimate.normal),
        covariance: turned(&estimate.covariance),
        curvature: estimate.curvature.as_ref().map(turned),
        ..*estimate
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
            return self.inner.update(sample);
        };
        let unusable = BaseMotion {
            trouble: Some(BaseTrouble::NotFinite),
            ..BaseMotion::still()
        };
        let base = if is_sane(base) { base } else { &unusable };
        to_base(&self.inner.update(&to_floor(sample, base)), base)
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
