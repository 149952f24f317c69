//! Commands to the arm and measurements from it, once per arm period.

use tangent_mechanics::Joints;

/// Velocity command of one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityCommand {
    /// Joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Bound on joint acceleration, rad/s² (as `a` of `speedj`).
    pub acceleration: f64,
}

impl VelocityCommand {
    /// Standstill, reached with 4 rad/s².
    pub fn hold() -> Self {
        Self {
            qd: Joints::<6>::zeros(),
            acceleration: 4.0,
        }
    }
}

/// What the arm's controller reports at the end of a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmMeasurement<const N: usize = 6> {
    /// Time since the plant was made, s.
    pub time_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<N>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Target positions of the servo, rad.
    pub q_target: Joints<N>,
    /// Target velocities of the servo, rad/s.
    pub qd_target: Joints<N>,
}
