//! One record of the force/torque sensor.

/// One record of the force/torque sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorSample {
    /// Time since the plant was created, s.
    pub time_s: f64,
    /// Fx, Fy, Fz, Tx, Ty, Tz in counts, sensor axes: load of the environment and gravity on the
    /// sensor.
    pub counts: [i32; 6],
    /// Whether a gauge is at the end of its range.
    pub saturated: bool,
}
