//! Where the tip touches, and what the torque says of its tilt, for each shape of a tip.

use nalgebra::Vector3;
use tangent_mechanics::Tip;

use super::ContactFilter;
use super::state::{CentreOfPressure, ContactFilterState, NORMAL, Row};
use crate::motion::Motion;

/// Uncertainty of the shift of the centre of pressure that a tilt causes, relative: radius and
/// stiffness are known roughly.
const FLUSH_DOUBT: f64 = 1.0;
/// Uncertainty of a compliance that was not measured yet, as a factor.
const COMPLIANCE_DOUBT: f64 = 4.0;
/// Standard deviation of the angle between the pad's normal and the tool's axis, rad.
const FLUSH_SD_RAD: f64 = 0.005;
/// Standard deviation of the point of contact beside that which tip and torque tell, m: a pad that
/// is flush seems to press beside its middle.
pub(super) const POSITION_SD_M: f64 = 3e-4;
/// Largest distance of the contact from the tool's origin for a tip of unknown shape, m.
const UNKNOWN_RADIUS_M: f64 = 0.01;

/// How a pad answers to a tilt.
struct Pad {
    radius_m: f64,
    /// `tilt = tilt_share N c / (k R²)` of a centre of pressure at a distance `c`.
    tilt_share: f64,
    /// Distance of the centre of pressure at which one side begins to lift, as a share of the
    /// radius: further out, the torque no longer tells how large the tilt is.
    lifts_at: f64,
}

/// A bed of springs under a disk or a rim; `None` for tips whose torque tells nothing of a tilt.
fn pad(tip: &Tip) -> Option<Pad> {
    let pad = |radius_m, tilt_share, lifts_at| {
        (radius_m > 0.0).then_some(Pad {
            radius_m,
            tilt_share,
            lifts_at,
        })
    };
    match *tip {
        Tip::Flat { radius_m } => pad(radius_m, 4.0, 0.25),
        Tip::Ring { radius_m } => pad(radius_m, 2.0, 0.5),
        Tip::Round { .. } | Tip::Soft { .. } | Tip::Unknown => None,
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
                self.pressed_at(radius_m, motion, pressing_n)
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
            Tip::Unknown => self.pressed_at(UNKNOWN_RADIUS_M, motion, pressing_n),
        }
    }

    fn pressed_at(&self, radius_m: f64, motion: &Motion, pressing_n: f64) -> CentreOfPressure {
        let spread = 0.5 * radius_m;
        let measured_sd = (self.config.sensing.torque_sd_nm / pressing_n).hypot(POSITION_SD_M);
        let total = spread * spread + measured_sd * measured_sd;
        let share = spread * spread / total;
        let torque = &motion.torque_in_tool;
        let mut centre = Vector3::new(torque.y, -torque.x, 0.0) * (share / pressing_n);
        if centre.norm() > radius_m {
            centre *= radius_m / centre.norm();
        }
        CentreOfPressure {
            position: motion.rotation * centre,
            sd_m: spread * measured_sd / total.sqrt(),
        }
    }

    /// A tilted flat pad is pressed harder on one side, so the centre of pressure measures the
    /// tilt, as well as pad and stiffness are known, until one side lifts. Only the best
    /// measurement counts, because torque bias and stiffness are the same in all of them.
    pub(super) fn measure_flush(
        &self,
        state: &mut ContactFilterState,
        motion: &Motion,
        pressing_n: f64,
    ) {
        let Some(pad) = pad(&self.config.contact.tip) else {
            return;
        };
        if pressing_n < self.config.contact.force_on_n {
            return;
        }
        let sd_m = state.centre.sd_m;
        if state.centre.position.norm() + 2.0 * sd_m > pad.lifts_at * pad.radius_m {
            return;
        }
        let z: Vector3<f64> = motion.rotation.column(2).into();
        // The tilt against the surface, plus the turn of the surface itself between the middle and
        // the centre of pressure.
        let soft = pad.tilt_share * pressing_n * state.compliance.m_per_n / pad.radius_m.powi(2);
        let centre = state.surface.frame.project(&state.centre.position);
        let tilt = centre * soft + state.surface.shape * centre;
        let unknown = if state.compliance.is_measured {
            1.0
        } else {
            COMPLIANCE_DOUBT
        };
        let doubt = (unknown * soft).hypot(self.config.surface.curvature_sd_per_m);
        let variance = (FLUSH_DOUBT * doubt * centre.norm()).powi(2)
            + (doubt * sd_m).powi(2)
            + FLUSH_SD_RAD.powi(2);
        let gained = 1.0 / variance - state.touch.flush_information;
        if gained <= 0.02 * state.touch.flush_information {
            return;
        }
        state.touch.flush_information = 1.0 / variance;
        let innovation = state.surface.frame.project(&-z) - tilt;
        for i in 0..2 {
            let mut row = Row::zeros();
            row[NORMAL + i] = 1.0;
            self.correct(state, &row, innovation[i], 1.0 / gained);
        }
    }

    /// Radius of the area whose mean normal a tip measures, m.
    pub(super) fn area_radius_m(&self) -> f64 {
        pad(&self.config.contact.tip).map_or(0.0, |pad| pad.radius_m)
    }
}
