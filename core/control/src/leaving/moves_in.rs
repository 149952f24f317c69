//! Whether an arm still moves in when a motion away from the surface begins.
//!
//! Called by `leave_watch` and `retreat` each cycle.

/// Maximum time for an arm that still moves in to reverse, s: its own lag plus the lag of the
/// reading. A force that increases during this time is no obstacle.
pub(super) const TURN_S: f64 = 0.15;
/// Lag of the reading, s: a force that rises for so long after the tool's last motion in comes from
/// that motion.
const READ_S: f64 = 0.03;
/// Distance against the motion away, or into what pressed when it began, that shows that the arm
/// still moves in, m: above a joint encoder's noise at the tool.
pub(super) const STILL_IN_M: f64 = 2e-5;

/// How far in the tool has come since the motion away began, and when.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MovesIn {
    /// Place furthest in, m, and when it was reached if the tool has moved to it, s.
    deepest_m: Option<f64>,
    deepest_s: Option<f64>,
    /// Time since the start, s.
    pub elapsed_s: f64,
}

impl MovesIn {
    /// Processes one cycle with the tool at `out_m` (m, larger further out). Returns whether what
    /// presses may still rise from the arm's own motion.
    pub fn step(&mut self, out_m: f64, dt_s: f64) -> bool {
        self.elapsed_s += dt_s;
        let deepest_m = self.deepest_m.get_or_insert(out_m);
        if out_m < *deepest_m - STILL_IN_M {
            *deepest_m = out_m;
            self.deepest_s = Some(self.elapsed_s);
        }
        self.deepest_s
            .is_some_and(|deepest_s| self.elapsed_s <= TURN_S.min(deepest_s + READ_S))
    }
}
