//! Where the torque says that the force acts, now and in the mean since the touch.
//!
//! Called by the filter each cycle in contact; tip and tilt take the centre of pressure from it.

use nalgebra::Vector3;

/// Time over which the torque is averaged that shows the centre of pressure, s: noise of the force
/// acts on it with the distance from the sensor to the tip as its lever.
const TORQUE_MEAN_S: f64 = 0.05;

/// Where a force along the tool's axis acts that causes the torque, tool axes, m.
pub(super) fn centre_by_torque(torque_nm: &Vector3<f64>, pressing_n: f64) -> Vector3<f64> {
    Vector3::new(torque_nm.y, -torque_nm.x, 0.0) / pressing_n
}

/// Running means of torque and pressing force since the touch. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TorqueMean {
    /// Torque at the tool's origin, tool axes, Nm.
    torque_nm: Vector3<f64>,
    pressing_n: f64,
    /// Time since the touch, s.
    since_s: f64,
}

impl TorqueMean {
    pub fn add(&mut self, torque_nm: &Vector3<f64>, pressing_n: f64, dt_s: f64) {
        self.since_s += dt_s;
        let gain = (dt_s / self.since_s.min(TORQUE_MEAN_S)).min(1.0);
        self.torque_nm += (torque_nm - self.torque_nm) * gain;
        self.pressing_n += (pressing_n - self.pressing_n) * gain;
    }

    /// Where the mean force acts, tool axes, m.
    pub fn centre(&self) -> Vector3<f64> {
        centre_by_torque(&self.torque_nm, self.pressing_n)
    }
}
