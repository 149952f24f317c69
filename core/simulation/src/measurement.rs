//! What the cell's instruments say: arm and force/torque sensor, once per arm period.

use tangent_mechanics::Joints;

/// What the arm is asked for in one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityCommand {
    /// rad/s
    pub qd: Joints<6>,
    /// Bound on joint acceleration, rad/s² (as `a` of `speedj`).
    pub acceleration: f64,
}

impl VelocityCommand {
    /// Stand still, reached with 4 rad/s².
    pub fn hold() -> Self {
        Self {
            qd: Joints::<6>::zeros(),
            acceleration: 4.0,
        }
    }
}

/// What the arm's controller reports at the end of a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmMeasurement {
    /// Time since the plant was made, s.
    pub time_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<6>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Positions the servo aims for, rad.
    pub q_target: Joints<6>,
    /// Velocities the servo aims for, rad/s.
    pub qd_target: Joints<6>,
}

/// One record of the force/torque sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorSample {
    /// Time since the plant was made, s.
    pub time_s: f64,
    /// Fx, Fy, Fz, Tx, Ty, Tz in counts, sensor axes: what the environment and gravity do to the
    /// sensor.
    pub counts: [i32; 6],
    /// A gauge is at its end.
    pub saturated: bool,
}
