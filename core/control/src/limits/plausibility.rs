//! Whether an input is plausible: finite, and small enough that computing with it does not
//! overflow. Called by every law at the start of its step.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Joints, Pose, Twist, Wrench};

/// Valid periods, s.
const PERIOD_S: std::ops::RangeInclusive<f64> = 1e-5..=0.1;
/// Largest plausible joint position, rad.
const POSITION_MAX_RAD: f64 = 100.0;
/// Largest plausible distance of a point from the arm's base, m.
const PLACE_MAX_M: f64 = 1000.0;
/// Largest plausible variance of a direction, rad².
const VARIANCE_MAX: f64 = 100.0;
/// Largest plausible curvature of a surface, 1/m.
const CURVATURE_MAX_PER_M: f64 = 1e4;
/// Largest plausible force, N, and torque, Nm.
const WRENCH_MAX: f64 = 1e6;
/// Largest plausible joint speed, rad/s, and tool speed, m/s and rad/s.
const SPEED_MAX_RAD_PER_S: f64 = 100.0;

/// Whether a law can compute with this cycle's clock and period, both s. Checked apart from the
/// arm's state, because no timeout works on a clock that is NaN.
pub(crate) fn is_time(time_s: f64, dt_s: f64) -> bool {
    time_s.is_finite() && PERIOD_S.contains(&dt_s)
}

/// Whether these are plausible joint positions, rad, and velocities, rad/s: finite, and small
/// enough that computing with them does not overflow.
pub(crate) fn is_arm_state<const N: usize>(q: &Joints<N>, qd: &Joints<N>) -> bool {
    within(q.as_slice(), POSITION_MAX_RAD) && within(qd.as_slice(), SPEED_MAX_RAD_PER_S)
}

/// Whether this is a plausible pose near an arm, `translation` in m: values far beyond its reach,
/// although finite, overflow in later steps.
pub(crate) fn is_place<A, B>(pose: &Pose<A, B>) -> bool {
    within(pose.translation().as_slice(), PLACE_MAX_M)
        && (pose.rotation().coords.norm() - 1.0).abs() < 1e-6
}

/// Whether this is a plausible velocity of a tool, m/s and rad/s.
pub(crate) fn is_velocity<F>(twist: &Twist<F>) -> bool {
    within(twist.linear.as_slice(), SPEED_MAX_RAD_PER_S)
        && within(twist.angular.as_slice(), SPEED_MAX_RAD_PER_S)
}

/// Whether this is a plausible point near an arm, m.
pub(crate) fn is_point(point: &Vector3<f64>) -> bool {
    within(point.as_slice(), PLACE_MAX_M)
}

/// Whether this is a plausible covariance of a direction, rad²: symmetric, positive semidefinite,
/// and bounded.
pub(crate) fn is_covariance(c: &Matrix3<f64>) -> bool {
    if !within(c.as_slice(), VARIANCE_MAX) {
        return false;
    }
    let rounding = 1e-9 * (1.0 + c.trace().abs());
    (0..3).all(|i| {
        let j = (i + 1) % 3;
        let minor = c[(i, i)] * c[(j, j)] - c[(i, j)] * c[(j, i)];
        c[(i, i)] >= -rounding
            && (c[(i, j)] - c[(j, i)]).abs() <= rounding
            && minor >= -rounding * (1.0 + c.trace().abs())
    })
}

/// Whether this is a plausible curvature of a surface, 1/m.
pub(crate) fn is_curvature(c: &Matrix3<f64>) -> bool {
    within(c.as_slice(), CURVATURE_MAX_PER_M)
}

/// Whether this is a plausible wrench, N and Nm: values beyond the range of any sensor, although
/// finite, overflow in later steps.
pub(crate) fn is_wrench<F>(wrench: &Wrench<F>) -> bool {
    within(wrench.force.as_slice(), WRENCH_MAX) && within(wrench.torque.as_slice(), WRENCH_MAX)
}

/// False for NaN as well.
fn within(values: &[f64], most: f64) -> bool {
    values.iter().all(|x| x.abs() <= most)
}
