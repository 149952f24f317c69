//! Limits of the cell that no task and no law may exceed, and the limiter that keeps a twist within
//! them.

pub(crate) mod answer;
pub(crate) mod arm_force;
pub(crate) mod direction;
pub(crate) mod falling_away;
pub mod faults;
pub(crate) mod joint_guard;
pub(crate) mod lateness;
pub(crate) mod motor_force;
pub(crate) mod plausibility;
pub(crate) mod reference_probe;
pub(crate) mod response_guard;
pub(crate) mod standstill;
pub(crate) mod touch;
pub(crate) mod turn_guard;
pub mod wrench_guard;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Aligned, Base, DampedLeastSquares, Tool, Twist};

use crate::error::{ControlError, check_range};
use crate::inputs::UntaredLoad;
use crate::limits::faults::{Excess, Fault};

/// Limits of the cell. The bridge enforces its own, wider limits as well.
///
/// ```
/// use tangent_control::Limits;
///
/// let limits = Limits { force_max_n: 30.0, ..Limits::default() };
/// limits.check()?;
/// // The untared reading may be 5 N higher, for the drift of a zero.
/// assert_eq!(limits.untared_max_n(), 35.0);
///
/// let error = Limits { speed_max_m_per_s: 5.0, ..limits }.check().unwrap_err();
/// assert!(error.to_string().contains("limits.speed_max_m_per_s"));
/// # Ok::<(), tangent_control::ControlError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Speed of the tool's origin, m/s.
    pub speed_max_m_per_s: f64,
    /// Acceleration of the tool's origin, m/s².
    pub acceleration_max_m_per_s2: f64,
    /// Deceleration of the tool's origin when something stands in its way, m/s². A value below
    /// that of the acceleration has no effect.
    pub braking_max_m_per_s2: f64,
    /// Angular speed of the tool, rad/s.
    pub turn_rate_max_rad_per_s: f64,
    /// Angular acceleration of the tool, rad/s².
    pub turn_acceleration_max_rad_per_s2: f64,
    /// Share of the arm's own joint speed limits, 0 to 1.
    pub joint_speed_share: f64,
    /// Joint acceleration, rad/s².
    pub joint_acceleration_max_rad_per_s2: f64,
    /// Distance kept from a joint's end stops, rad.
    pub joint_margin_rad: f64,
    /// Force at the tool beyond which the arm retracts, N.
    pub force_max_n: f64,
    /// Torque at the tool beyond which the arm retracts, Nm.
    pub torque_max_nm: f64,
    /// Force that the arm itself feels, and the sensor does not show, beyond which a tool that
    /// moves towards a surface retracts, N: well above the error of the arm's own force.
    pub unread_force_max_n: f64,
    /// Force beyond which the arm retracts regardless of the current zero, N: the untared reading
    /// relative to the last zero taken after a motion had shown the tool free. `None`:
    /// `force_max_n` plus 5 N for the drift of a zero.
    pub untared_force_max_n: Option<f64>,
    /// Largest share of the sensor's rating that the untared reading may take in any axis.
    pub untared_share_max: f64,
    /// Lower corner of the box in which the tool's origin stays while it works, base axes, m.
    pub workspace_min_m: [f64; 3],
    /// Upper corner of the box, base axes, m.
    pub workspace_max_m: [f64; 3],
    /// Power put into the surface along the normal, W.
    pub power_max_w: f64,
    /// Distance against the normal without contact after which the arm gives up and retracts, m.
    pub blind_distance_max_m: f64,
    /// Damping of the inverse Jacobian (eq. 3) near a singularity.
    pub singularity: DampedLeastSquares,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            speed_max_m_per_s: 0.25,
            acceleration_max_m_per_s2: 1.0,
            braking_max_m_per_s2: 4.0,
            turn_rate_max_rad_per_s: 1.0,
            turn_acceleration_max_rad_per_s2: 10.0,
            joint_speed_share: 0.5,
            joint_acceleration_max_rad_per_s2: 15.0,
            joint_margin_rad: 0.05,
            force_max_n: 40.0,
            torque_max_nm: 5.0,
            unread_force_max_n: 30.0,
            untared_force_max_n: None,
            untared_share_max: 0.7,
            workspace_min_m: [-2.0; 3],
            workspace_max_m: [2.0; 3],
            power_max_w: 0.5,
            blind_distance_max_m: 0.03,
            singularity: DampedLeastSquares::default(),
        }
    }
}

impl Limits {
    /// Checks that every number is in its range.
    pub fn check(&self) -> Result<(), ControlError> {
        let positive =
            |key: &str, value, upper| check_range(&format!("limits.{key}"), value, 1e-6, upper);
        positive("speed_max_m_per_s", self.speed_max_m_per_s, 2.0)?;
        positive(
            "acceleration_max_m_per_s2",
            self.acceleration_max_m_per_s2,
            50.0,
        )?;
        positive("braking_max_m_per_s2", self.braking_max_m_per_s2, 50.0)?;
        positive("turn_rate_max_rad_per_s", self.turn_rate_max_rad_per_s, 6.0)?;
        positive(
            "turn_acceleration_max_rad_per_s2",
            self.turn_acceleration_max_rad_per_s2,
            200.0,
        )?;
        positive("joint_speed_share", self.joint_speed_share, 1.0)?;
        positive(
            "joint_acceleration_max_rad_per_s2",
            self.joint_acceleration_max_rad_per_s2,
            100.0,
        )?;
        check_range("limits.joint_margin_rad", self.joint_margin_rad, 0.0, 1.0)?;
        positive("force_max_n", self.force_max_n, 1000.0)?;
        positive("torque_max_nm", self.torque_max_nm, 1000.0)?;
        check_range(
            "limits.unread_force_max_n",
            self.unread_force_max_n,
            5.0,
            1000.0,
        )?;
        positive("untared_force_max_n", self.untared_max_n(), 1005.0)?;
        positive("untared_share_max", self.untared_share_max, 1.0)?;
        for i in 0..3 {
            let (lower, upper) = (self.workspace_min_m[i], self.workspace_max_m[i]);
            check_range("limits.workspace_min_m", lower, -10.0, 10.0)?;
            check_range("limits.workspace_max_m", upper, lower, 10.0)?;
        }
        positive("power_max_w", self.power_max_w, 100.0)?;
        positive("blind_distance_max_m", self.blind_distance_max_m, 0.5)?;
        positive(
            "singularity.damping_max",
            self.singularity.damping_max,
            10.0,
        )?;
        positive("singularity.threshold", self.singularity.threshold, 10.0)
    }
}

/// Drift of a zero that the limit on the untared reading allows for, N.
const DRIFT_N: f64 = 5.0;

impl Limits {
    /// Limit of the untared force beyond which the arm retracts, N, relative to the last zero that
    /// a motion has shown to be free of load.
    pub fn untared_max_n(&self) -> f64 {
        self.untared_force_max_n
            .unwrap_or(self.force_max_n + DRIFT_N)
    }

    /// The fault of a force (N) or a torque (Nm) beyond its limit.
    pub(crate) fn overload(&self, force_n: f64, torque_nm: f64) -> Option<Fault> {
        let force = Excess::over(force_n, self.force_max_n).map(Fault::ForceLimit);
        let torque = || Excess::over(torque_nm, self.torque_max_nm).map(Fault::TorqueLimit);
        force.or_else(torque)
    }

    /// Whether the untared reading is beyond its limit.
    pub fn is_untared_beyond(&self, untared: &UntaredLoad) -> bool {
        // Written so that NaN is beyond the limit.
        let beyond = |value: Option<f64>, most| value.is_some_and(|x| x.is_nan() || x > most);
        beyond(untared.beyond_reference_n, self.untared_max_n())
            || beyond(untared.rated_share, self.untared_share_max)
    }
}

/// `vector`, shortened to `length` if longer.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_control::clamp_norm;
///
/// let vector = Vector3::new(3.0, 4.0, 0.0);
/// assert_eq!(clamp_norm(vector, 2.5), Vector3::new(1.5, 2.0, 0.0));
/// assert_eq!(clamp_norm(vector, 6.0), vector);
/// ```
pub fn clamp_norm(vector: Vector3<f64>, length: f64) -> Vector3<f64> {
    let norm = vector.norm();
    if norm > length {
        vector * (length / norm)
    } else {
        vector
    }
}

/// Keeps a commanded twist within speed and acceleration limits. Its state is the last twist it
/// returned.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_control::{Limits, TwistLimiter};
/// use tangent_mechanics::Twist;
///
/// // 0.25 m/s and 1 m/s².
/// let limits = Limits::default();
/// let mut limiter = TwistLimiter::default();
/// let wanted = Twist::new(Vector3::new(1.0, 0.0, 0.0), Vector3::zeros());
///
/// // The first cycle of 8 ms is bounded by the acceleration, the hundredth by the speed.
/// let first = limiter.step(&limits, wanted, 0.008);
/// assert!((first.linear.x - 0.008).abs() < 1e-12);
/// for _ in 1..100 {
///     limiter.step(&limits, wanted, 0.008);
/// }
/// assert!((limiter.last().linear.x - 0.25).abs() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct TwistLimiter {
    last: Twist<Aligned<Tool, Base>>,
}

impl Default for TwistLimiter {
    fn default() -> Self {
        Self {
            last: Twist::zero(),
        }
    }
}

impl TwistLimiter {
    /// The twist nearest to `wanted` (starting from the last one) within `limits`. A twist that is
    /// not finite requests a stop.
    pub fn step(
        &mut self,
        limits: &Limits,
        wanted: Twist<Aligned<Tool, Base>>,
        dt_s: f64,
    ) -> Twist<Aligned<Tool, Base>> {
        self.within(limits, limits.acceleration_max_m_per_s2, wanted, dt_s)
    }

    /// As [`TwistLimiter::step`] for a tool with something in its way: with the deceleration for
    /// that case in place of the acceleration.
    pub fn brake(
        &mut self,
        limits: &Limits,
        wanted: Twist<Aligned<Tool, Base>>,
        dt_s: f64,
    ) -> Twist<Aligned<Tool, Base>> {
        let most = limits
            .braking_max_m_per_s2
            .max(limits.acceleration_max_m_per_s2);
        self.within(limits, most, wanted, dt_s)
    }

    fn within(
        &mut self,
        limits: &Limits,
        acceleration_m_per_s2: f64,
        wanted: Twist<Aligned<Tool, Base>>,
        dt_s: f64,
    ) -> Twist<Aligned<Tool, Base>> {
        let wanted = if wanted.is_finite() {
            wanted
        } else {
            Twist::zero()
        };
        let linear = clamp_norm(wanted.linear, limits.speed_max_m_per_s);
        let angular = clamp_norm(wanted.angular, limits.turn_rate_max_rad_per_s);
        self.last = Twist::new(
            self.last.linear + clamp_norm(linear - self.last.linear, acceleration_m_per_s2 * dt_s),
            self.last.angular
                + clamp_norm(
                    angular - self.last.angular,
                    limits.turn_acceleration_max_rad_per_s2 * dt_s,
                ),
        );
        self.last
    }

    /// The last twist returned.
    pub fn last(&self) -> Twist<Aligned<Tool, Base>> {
        self.last
    }

    /// Resets the state to rest: the arm stands.
    pub fn reset(&mut self) {
        self.last = Twist::zero();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_number() -> impl Strategy<Value = f64> {
        prop_oneof![
            -1.0f64..1.0,
            -1e9f64..1e9,
            Just(f64::NAN),
            Just(f64::INFINITY)
        ]
    }

    proptest! {
        #[test]
        fn never_beyond_the_limits_for_any_input(wanted in prop::collection::vec(prop::array::uniform6(any_number()), 1..50)) {
            let limits = Limits::default();
            let mut limiter = TwistLimiter::default();
            let dt = 0.008;
            for w in wanted {
                let before = limiter.last();
                let out = limiter.step(&limits, Twist::from_vector(&w.into()), dt);
                prop_assert!(out.is_finite());
                prop_assert!(out.linear.norm() <= limits.speed_max_m_per_s * (1.0 + 1e-9));
                prop_assert!(out.angular.norm() <= limits.turn_rate_max_rad_per_s * (1.0 + 1e-9));
                let step = out - before;
                prop_assert!(step.linear.norm() <= limits.acceleration_max_m_per_s2 * dt * (1.0 + 1e-9));
                prop_assert!(step.angular.norm() <= limits.turn_acceleration_max_rad_per_s2 * dt * (1.0 + 1e-9));
            }
        }
    }

    #[test]
    fn the_default_is_in_range() {
        Limits::default().check().unwrap();
        let wrong = Limits {
            power_max_w: f64::NAN,
            ..Limits::default()
        };
        let error = wrong.check().unwrap_err().to_string();
        assert!(error.contains("limits.power_max_w"), "{error}");
    }
}
