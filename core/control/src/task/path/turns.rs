//! Turns within a chain of straight lines: slight ones are passed at one speed, without a stop.

use nalgebra::Vector2;

/// Largest turn of the direction that is passed without a stop, rad.
pub(super) const TURN_MAX_RAD: f64 = 0.35;
/// Time within which the arm may accelerate in a turn, s: its speed changes by no more than the
/// acceleration of the path in this time.
const TURN_S: f64 = 0.1;

/// Angle by which the direction turns at `b`, rad.
pub(super) fn turn_rad(a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>) -> f64 {
    let (u, v) = (b - a, c - b);
    u.perp(&v).abs().atan2(u.dot(&v))
}

/// Highest speed at which a turn is passed, m/s.
pub(super) fn turn_speed_m_per_s(turn_rad: f64, acceleration_m_per_s2: f64) -> f64 {
    acceleration_m_per_s2 * TURN_S / turn_rad.max(1e-9)
}
