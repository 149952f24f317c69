//! Whether a reading stays constant while the tool goes deeper or comes out.
//!
//! Called by `response_guard` in each cycle in which the tool presses.

use nalgebra::{Vector3, Vector6};

use crate::contact::alignment::depth_and_across;
use crate::limits::touch::Touch;

/// Lower bound assumed for the stiffness, N/m: high, so that a short distance is enough. A dead
/// sensor makes every contact look soft.
const STIFFNESS_N_PER_M: f64 = 25_000.0;
/// A reading that changes by less than this is constant, N: a payload that turns with the tool
/// changes it slightly.
const STILL_N: f64 = 5e-3;
/// Additional change per metre of depth below which a reading counts as constant, N/m: a quarter of
/// the softest surface's stiffness.
const STILL_N_PER_M: f64 = 250.0;
/// Force that may build up undetected while the reading is constant, N, or this share of the
/// reference.
pub(super) const UNFELT_N: f64 = 1.5;
const UNFELT_SHARE: f64 = 0.5;
/// Time until a reading shows the effect of a motion, s.
const LATE_S: f64 = 0.03;
/// Minimum distance that counts, m: above a joint encoder's noise at the tool.
const WAY_MIN_M: f64 = 2e-5;
/// Distance after which the decision is made, m.
pub(super) const WAY_M: f64 = 2e-3;

/// A reading that stays constant, and the tool's motion since.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Standstill {
    wrench: Vector6<f64>,
    /// Depth into the surface, m, along the normals in use during the motion.
    depth_m: f64,
    /// Distance across those normals, m.
    across_m: f64,
    /// Distance that an edge of the tip has moved along them while the tool turned, m.
    edge_m: f64,
    /// Part of the depth that the reading can show by now, m.
    late_m: f64,
    since_s: f64,
}

impl Standstill {
    /// Begins with this reading.
    pub fn at(touch: &Touch) -> Self {
        Self {
            wrench: touch.wrench,
            depth_m: 0.0,
            across_m: 0.0,
            edge_m: 0.0,
            late_m: 0.0,
            since_s: 0.0,
        }
    }

    /// Processes one cycle of a tool that presses, and that has moved by `step` (m).
    pub fn judge(&mut self, touch: &Touch, step: &Vector3<f64>) -> Judgement {
        let (deeper_m, across_m) = depth_and_across(step, &touch.normal);
        self.depth_m += deeper_m;
        self.across_m += across_m;
        self.edge_m += touch
            .depth
            .map_or(0.0, |rule| rule.edge_speed_m_per_s * touch.dt_s);
        self.late_m += (self.depth_m - self.late_m) * (touch.dt_s / (touch.dt_s + LATE_S));
        self.since_s += touch.dt_s;
        let Self {
            depth_m,
            across_m,
            edge_m,
            late_m,
            since_s,
            ..
        } = *self;
        let changed = (touch.wrench - self.wrench).fixed_rows::<3>(0).norm();
        // On the way out the reading need not change much: a hand that lifts the tool off gives a
        // steady reading. It still varies more than a dead sensor's, and the true force falls.
        let still_n = STILL_N.max(STILL_N_PER_M * late_m);
        if changed > still_n {
            *self = Self::at(touch);
            return Judgement::Changes;
        }
        let stiffness = touch
            .stiffness_n_per_m
            .unwrap_or(0.0)
            .max(STIFFNESS_N_PER_M);
        let unfelt = UNFELT_N.max(UNFELT_SHARE * touch.reference_n);
        let enough = (unfelt / stiffness).clamp(WAY_MIN_M, WAY_M);
        // A normal that is off by 20 degrees turns sliding along the surface into apparent depth.
        let stands = since_s >= LATE_S && depth_m.abs() - 0.36 * across_m - edge_m >= enough;
        let probes = touch.probe.is_some() && touch.depth.is_some_and(|rule| !rule.settling);
        if !stands {
            Judgement::Changes
        } else if probes && changed > STILL_N {
            // A reading that changes a little may be a surface far softer than thought.
            Judgement::Doubtful
        } else {
            Judgement::Stands
        }
    }
}

/// What the reading did while the tool moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Judgement {
    /// It changes, or the tool has not moved far enough.
    Changes,
    /// It stays constant.
    Stands,
    /// It changes too little, and may be proved by a lower reference.
    Doubtful,
}
