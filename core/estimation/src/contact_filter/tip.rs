//! Where the tip touches, for each shape of a tip.

use tangent_mechanics::Tip;

use super::ContactFilter;
use super::state::{CentreOfPressure, ContactFilterState, NORMAL};
use crate::motion::Motion;

/// Standard deviation of the point of contact beside that which tip and torque tell, m: a pad that
/// is flush seems to press beside its middle.
pub(super) const POSITION_SD_M: f64 = 3e-4;
/// Largest distance of the contact from the tool's origin for a tip of unknown shape, m.
const UNKNOWN_RADIUS_M: f64 = 0.01;

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
        let mut centre = state.torque.centre() * share;
        if centre.norm() > radius_m {
            centre *= radius_m / centre.norm();
        }
        CentreOfPressure {
            position: motion.rotation * centre,
            sd_m: spread * measured_sd / total.sqrt(),
        }
    }
}
