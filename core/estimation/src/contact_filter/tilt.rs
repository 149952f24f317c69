//! What the torque says of the tilt of a pad: how far it is tilted while all of it presses, and on
//! which side it is too high while it stands on its rim.

use nalgebra::Vector2;
use tangent_mechanics::Tip;

use super::ContactFilter;
use super::state::{ContactFilterState, HeightMemory, NORMAL, Row, SurfaceState};
use super::torque_mean::centre_by_torque;
use crate::motion::Motion;

/// Constant error of the centre of pressure per axis, m: frames of tip and sensor, at the length of
/// a usual tool.
const CENTRE_SD_M: f64 = 0.002;
/// Uncertainty of how far a force across bends the tip aside, as a share of it.
const BENT_DOUBT: f64 = 0.7;
/// Compliance across the tool's axis that is at least assumed, as a share of that along it.
const ACROSS_SHARE: f64 = 0.5;

/// Distance of the centre of pressure from the middle up to which the whole pad presses, as a share
/// of its radius.
const WHOLE_SHARE: f64 = 0.5;
/// Share of the compliance along the tool's axis that is the pad's own and the surface's: the rest,
/// of tool and wrist, gives without a tilt.
const PAD_SHARE: f64 = 0.5;
/// Uncertainty of the shift of the centre of pressure that a tilt causes, relative: radius and
/// stiffness are known roughly.
const SHIFT_DOUBT: f64 = 1.0;
/// Uncertainty of a compliance that was not measured yet, as a factor.
const COMPLIANCE_DOUBT: f64 = 4.0;
/// Standard deviation of the angle between the pad's normal and the tool's axis, rad.
const PAD_SD_RAD: f64 = 0.01;

/// Standard deviations of the centre of pressure from the middle beyond which it shows a side.
const SIDE_SDS: f64 = 2.0;
/// Time from one look at the rim to the next, s.
const LOOK_S: f64 = 0.1;
/// Standard deviations of the normal by which the tool may be ahead of what the rim shows, so that
/// it is looked at again.
const LOOK_SDS: f64 = 0.5;
/// How far the tool is beyond a bound that it is known to exceed, standard deviations: the mean of
/// half a Gaussian, the square root of 2/pi.
const BEYOND_SDS: f64 = 0.8;
/// Most that one look turns the normal, rad.
const LOOK_MAX_RAD: f64 = 0.3;

/// How a pad answers to a tilt.
pub(super) struct Pad {
    pub radius_m: f64,
    /// `tilt = tilt_share N c / (k R²)` of a centre of pressure at a distance `c`.
    tilt_share: f64,
}

impl Pad {
    /// A bed of springs under a disk or a rim; `None` for tips whose torque tells nothing of a
    /// tilt.
    pub fn of(tip: &Tip) -> Option<Self> {
        let pad = |radius_m, tilt_share| {
            (radius_m > 0.0).then_some(Self {
                radius_m,
                tilt_share,
            })
        };
        match *tip {
            Tip::Flat { radius_m } => pad(radius_m, 4.0),
            Tip::Ring { radius_m } => pad(radius_m, 2.0),
            Tip::Round { .. } | Tip::Soft { .. } | Tip::Unknown => None,
        }
    }
}

/// Where a pad presses.
struct Pressed {
    /// Centre of pressure within the pad, tangent axes, m.
    at: Vector2<f64>,
    distance_m: f64,
    sd_m: f64,
    /// The tool's axis against the normal, tangent axes, rad.
    tool: Vector2<f64>,
    /// The normal at the centre of pressure against that in the middle, tangent axes, rad.
    bent: Vector2<f64>,
}

impl ContactFilter {
    /// Concludes from the torque how a pad is tilted.
    pub(super) fn measure_tilt(
        &self,
        state: &mut ContactFilterState,
        motion: &Motion,
        pressing_n: f64,
    ) {
        let Some(pad) = Pad::of(&self.config.contact.tip) else {
            return;
        };
        if pressing_n < self.config.contact.force_on_n {
            return;
        }
        let centre = centre_by_torque(&motion.torque_in_tool, pressing_n);
        let way_m = state.slide.speed_m_per_s * motion.dt_s;
        if !state.tilt.add(&centre, pressing_n, way_m, motion.dt_s) {
            return;
        }
        let give_m_per_n = match state.memory {
            HeightMemory::Followed => state.surface.give_m_per_n,
            HeightMemory::None | HeightMemory::Here => Vector2::repeat(state.compliance.m_per_n),
        };
        let Some(pressed) = self.pressed(state, motion, &pad, pressing_n, &give_m_per_n) else {
            return;
        };
        if pressed.distance_m + pressed.sd_m < WHOLE_SHARE * pad.radius_m {
            let soft_rad_per_m =
                pad.tilt_share * pressing_n * give_m_per_n.x / pad.radius_m.powi(2);
            state.tilt.press_whole();
            self.measure_whole_pad(state, &pressed, soft_rad_per_m);
        } else if pressed.distance_m > SIDE_SDS * pressed.sd_m
            && state.tilt.since_s > LOOK_S
            && state.tilt.is_early()
        {
            self.look_at_rim(state, &pressed);
        }
    }

    /// `None` where the force does not act within the pad.
    fn pressed(
        &self,
        state: &ContactFilterState,
        motion: &Motion,
        pad: &Pad,
        pressing_n: f64,
        give_m_per_n: &Vector2<f64>,
    ) -> Option<Pressed> {
        let frame = &state.surface.frame;
        let across_n = state.force_in_tool(motion).xy().norm();
        let bent_m = give_m_per_n.y.max(ACROSS_SHARE * give_m_per_n.x) * across_n;
        let sd_m = (self.config.sensing.torque_sd_nm / pressing_n)
            .hypot(CENTRE_SD_M)
            .hypot(BENT_DOUBT * bent_m);
        let measured = frame.project(&(motion.rotation * state.tilt.centre));
        let measured_m = measured.norm();
        if measured_m > 2.0 * (pad.radius_m + sd_m) {
            return None;
        }
        let distance_m = measured_m.min(pad.radius_m);
        let at = measured * (distance_m / measured_m.max(f64::MIN_POSITIVE));
        Some(Pressed {
            at,
            distance_m,
            sd_m,
            tool: frame.project(&-motion.rotation.column(2)),
            bent: state.surface.shape * at,
        })
    }

    /// A tilted pad is pressed harder on one side, so the centre of pressure measures the tilt, as
    /// well as pad and stiffness are known. Only the best measurement counts, because torque bias
    /// and stiffness are the same in all of them.
    fn measure_whole_pad(
        &self,
        state: &mut ContactFilterState,
        pressed: &Pressed,
        soft_rad_per_m: f64,
    ) {
        let unknown = if state.compliance.is_measured {
            1.0
        } else {
            COMPLIANCE_DOUBT
        };
        let curvature_sd = self.config.surface.curvature_sd_per_m;
        let doubt_rad_per_m = (unknown * soft_rad_per_m).hypot(curvature_sd);
        let variance = (SHIFT_DOUBT * doubt_rad_per_m * pressed.distance_m).powi(2)
            + ((soft_rad_per_m + doubt_rad_per_m) * pressed.sd_m).powi(2)
            + PAD_SD_RAD.powi(2);
        let gained = 1.0 / variance - state.tilt.information;
        if gained <= 0.02 * state.tilt.information {
            return;
        }
        state.tilt.information = 1.0 / variance;
        let tilt = pressed.at * (PAD_SHARE * soft_rad_per_m) + pressed.bent;
        let innovation = pressed.tool - tilt;
        for (i, axis) in [Vector2::x(), Vector2::y()].iter().enumerate() {
            self.correct(state, &along(axis), innovation[i], 1.0 / gained);
        }
    }

    /// A pad on its rim is tilted towards the side on which it presses, by an angle that the torque
    /// does not tell. Across that side it is a measurement. Along it, it is a bound: the normal
    /// turns as far as it is in the mean of all that obey it. Its variance stays as it is, because
    /// the frames' error is the same in all looks. Then the tool turns, until the pad presses on
    /// another side, or the next look shows that it is still not enough.
    fn look_at_rim(&self, state: &mut ContactFilterState, pressed: &Pressed) {
        let side = pressed.at / pressed.distance_m;
        let row = along(&side);
        let sd_rad = state.surface.sd_along(&row);
        let ahead_rad = pressed.tool.dot(&side);
        let room_rad = ahead_rad - pressed.bent.dot(&side).max(0.0);
        if room_rad > LOOK_SDS * sd_rad {
            return;
        }
        state.tilt.look_again();
        let curvature_sd = self.config.surface.curvature_sd_per_m;
        let variance = (ahead_rad.abs().max(sd_rad) * pressed.sd_m / pressed.distance_m).powi(2)
            + (curvature_sd * pressed.distance_m).powi(2)
            + PAD_SD_RAD.powi(2);
        let beside = Vector2::new(-side.y, side.x);
        let innovation = (pressed.tool - pressed.bent).dot(&beside);
        self.correct(state, &along(&beside), innovation, variance);
        let turn_rad = (BEYOND_SDS * sd_rad - room_rad).clamp(0.0, LOOK_MAX_RAD);
        state
            .surface
            .shift(&row, -turn_rad, self.config.surface.friction_max);
    }

    /// Radius of the area whose mean normal a tip measures, m.
    pub(super) fn area_radius_m(&self) -> f64 {
        Pad::of(&self.config.contact.tip).map_or(0.0, |pad| pad.radius_m)
    }
}

/// The derivative of the normal's turn along a unit vector of the tangent plane.
fn along(axis: &Vector2<f64>) -> Row {
    let mut row = Row::zeros();
    row.fixed_rows_mut::<2>(NORMAL).copy_from(axis);
    row
}

impl SurfaceState {
    fn sd_along(&self, row: &Row) -> f64 {
        row.dot(&(self.covariance * row)).max(0.0).sqrt()
    }

    /// Moves the mean by `change` along `row`, with all that correlates with it, and leaves the
    /// covariance.
    fn shift(&mut self, row: &Row, change: f64, friction_max: f64) {
        let gain = self.covariance * row;
        let variance = row.dot(&gain);
        if variance > 0.0 {
            self.add(&(gain * (change / variance)), friction_max);
        }
    }
}
