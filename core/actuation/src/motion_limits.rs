//! Limits on the motion of an arm, for all kinds of commands.

use nalgebra::Vector3;
use tangent_mechanics::Joints;

/// Limits on joints and tool that every gate enforces; per joint from base to flange.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_actuation::MotionLimits;
/// use tangent_mechanics::Joints;
///
/// let limits = MotionLimits::<6> {
///     speed_rad_per_s: Joints::repeat(1.0),
///     position_lower_rad: Joints::repeat(-3.0),
///     position_upper_rad: Joints::repeat(3.0),
///     tool_speed_max_m_per_s: 0.25,
///     tool_turn_rate_max_rad_per_s: 1.0,
///     workspace_lower_m: Vector3::new(-0.8, -0.8, 0.0),
///     workspace_upper_m: Vector3::new(0.8, 0.8, 1.2),
/// };
/// // The arm is stopped a little before the ends of its joints.
/// let limits = limits.inside(0.03);
/// assert_eq!(limits.position_upper_rad[0], 2.97);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct MotionLimits<const N: usize> {
    /// Largest joint speed, rad/s.
    pub speed_rad_per_s: Joints<N>,
    /// Smallest joint angle, rad.
    pub position_lower_rad: Joints<N>,
    /// Largest joint angle, rad.
    pub position_upper_rad: Joints<N>,
    /// Largest speed of the tool's origin, m/s.
    pub tool_speed_max_m_per_s: f64,
    /// Largest turn rate of the tool, rad/s.
    pub tool_turn_rate_max_rad_per_s: f64,
    /// Lower corner of the box in which the tool's origin stays, base axes, m.
    pub workspace_lower_m: Vector3<f64>,
    /// Upper corner of the box in which the tool's origin stays, base axes, m.
    pub workspace_upper_m: Vector3<f64>,
}

impl<const N: usize> MotionLimits<N> {
    /// These limits with the range of every joint narrowed by `margin_rad` at both ends.
    #[must_use]
    pub fn inside(mut self, margin_rad: f64) -> Self {
        let margin = Joints::repeat(margin_rad);
        self.position_lower_rad += margin;
        self.position_upper_rad -= margin;
        self
    }
}
