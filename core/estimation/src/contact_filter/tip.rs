//! Where the tip touches, for each shape of a tip.

use nalgebra::Vector3;
use tangent_mechanics::Tip;

use super::ContactFilter;
use super::state::{CentreOfPressure, ContactFilterState, NORMAL};
use crate::motion::Motion;

/// Standard deviation of the point of contact beside that which tip and torque tell, m: a pad that
/// is flush seems to press beside its middle.
pub(super) const POSITION_SD_M: f64 = 3e-4;
/// Largest distance of the contact from the tool's origin for a tip of unknown shape, m.
const UNKNOWN_RADIUS_M: f64 = 0.01;

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
}

impl ContactFilter {
    /// Computes the centre of pressure. For a pad it follows from the torque: the more uncertain
    /// the torque, the closer it is to the middle. A ball touches where its normal points.
    pub(super) fn centre_of_pressure(
        &self,
        state: &ContactFilterState,
        motion: &Motion,
        pressing_n: f64,
    ) -> CentreOfPressure {
        let tip = &self.config.contact.tip;
        match *tip {
            Tip::Flat { radius_m } | Tip::Ring { radius_m } | Tip::Soft { radius_m } => {
                self.pressed_at(radius_m, state, motion, pressing_n)
            }
            Tip::Round { radius_m } => {
                let normal = state.surface.frame.normal;
                let in_tool = motion.rotation.tr_mul(&normal);
                let covariance = state.surface.covariance.fixed_view::<2, 2>(NORMAL, NORMAL);
                let sd_rad = (0.5 * covariance.trace()).max(0.0).sqrt();
                CentreOfPressure {
                    position: motion.rotation * tip.contact_in_tool(&in_tool),
                    sd_m: radius_m * sd_rad.min(1.0),
                }
            }
            // Where the force acts does not depend on a shape; what it says of a tilt does.
            Tip::Unknown => self.pressed_at(UNKNOWN_RADIUS_M, state, motion, pressing_n),
        }
    }

    fn pressed_at(
        &self,
        radius_m: f64,
        state: &ContactFilterState,
        motion: &Motion,
        pressing_n: f64,
    ) -> CentreOfPressure {
        let spread = 0.5 * radius_m;
        let measured_sd = (self.config.sensing.torque_sd_nm / pressing_n).hypot(POSITION_SD_M);
        let total = spread * spread + measured_sd * measured_sd;
        let share = spread * spread / total;
        let mean = &state.torque;
        let mut centre = centre_by_torque(&mean.torque_nm, mean.pressing_n) * share;
        if centre.norm() > radius_m {
            centre *= radius_m / centre.norm();
        }
        CentreOfPressure {
            position: motion.rotation * centre,
            sd_m: spread * measured_sd / total.sqrt(),
        }
    }
}
