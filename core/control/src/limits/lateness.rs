//! Whether a reading rises long after the tool has stopped going deeper: readings that are old, and
//! come behind new sequence numbers.
//!
//! Called by `response_guard` each cycle in which the tool presses. Only the time after a touch is
//! judged, in which the tool hardly moves along the surface. Later, a rising surface looks the
//! same.

use crate::limits::touch::Touch;

/// Time from the start of the contact in which it is judged, s.
const JUDGED_S: f64 = 1.0;
/// Longest time until an honest reading shows a motion, s: the delay of its filter and of the arm's
/// own measurements.
const HONEST_S: f64 = 0.06;
/// Time for which the force stays higher, s: a blow is shorter.
const STAYS_S: f64 = 0.03;
/// Rise of the force that is more than noise and vibration, N, or as a share of the reference.
const RISE_N: f64 = 1.0;
const RISE_SHARE: f64 = 0.25;
/// Change of the depth that counts, m: more than the noise of an arm that stands.
const DEEPER_M: f64 = 5e-6;

/// State for one contact. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lateness {
    contact_s: f64,
    depth_m: f64,
    deepest_m: f64,
    /// Time since the tool was deepest, s.
    since_s: f64,
    /// Largest force within [`HONEST_S`] after that, N.
    honest_n: f64,
    /// Time since which the force is higher, s.
    higher_s: f64,
}

impl Lateness {
    /// Processes one cycle of a tool that may have gone deeper by as much as `deeper_m` (m).
    /// Returns whether the reading is late.
    pub fn is_late(&mut self, touch: &Touch, deeper_m: f64) -> bool {
        self.contact_s += touch.dt_s;
        self.since_s += touch.dt_s;
        self.depth_m += deeper_m;
        if self.depth_m > self.deepest_m + DEEPER_M {
            self.deepest_m = self.depth_m;
            self.since_s = 0.0;
            self.honest_n = touch.force_n;
        }
        if self.since_s <= HONEST_S {
            self.honest_n = self.honest_n.max(touch.force_n);
        }
        let rise_n = RISE_N.max(RISE_SHARE * touch.reference_n);
        if touch.force_n - self.honest_n > rise_n {
            self.higher_s += touch.dt_s;
        } else {
            self.higher_s = 0.0;
        }
        self.contact_s <= JUDGED_S && self.higher_s >= STAYS_S
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.002;

    /// A tool that goes in at 2 mm/s until it reads 3 N, then comes out at 1 mm/s, on a contact of
    /// `stiffness` N/m whose readings are `delay_s` old. Returns the true force, N, when that is
    /// noticed.
    fn noticed_n(stiffness: f64, delay_s: f64, vibrates_n: f64) -> Option<f64> {
        let mut lateness = Lateness::default();
        let (mut depths, mut depth_m, mut turned) = (Vec::new(), 0.0, false);
        let late = (delay_s / DT_S).round() as usize;
        for k in 0..1000_usize {
            depths.push(depth_m);
            let seen_m = k.checked_sub(late).map_or(0.0, |at| depths[at]);
            let force_n = stiffness * f64::max(seen_m, 0.0) + vibrates_n * (k as f64).sin();
            turned |= force_n >= 3.0;
            let step_m = DT_S * if turned { -1e-3 } else { 2e-3 };
            depth_m += step_m;
            if lateness.is_late(&Touch::pressing(force_n), step_m) {
                return Some(stiffness * depth_m);
            }
        }
        None
    }

    #[test]
    fn readings_that_are_a_fifth_of_a_second_old_are_noticed() {
        for stiffness in [5e3, 1e4, 2.5e4] {
            for delay_s in [0.2, 0.4] {
                let force_n = noticed_n(stiffness, delay_s, 0.1);
                assert!(force_n.is_some(), "{stiffness} N/m, {delay_s} s");
            }
            for delay_s in [0.0, 0.02, 0.05] {
                assert_eq!(noticed_n(stiffness, delay_s, 0.2), None, "{delay_s} s");
            }
        }
    }

    #[test]
    fn a_blow_is_no_late_reading_and_a_step_that_stays_is() {
        for (lasts, expected) in [(10, false), (20, true)] {
            let mut lateness = Lateness::default();
            let late = (0..400).any(|k| {
                let force_n = if (200..200 + lasts).contains(&k) {
                    8.0
                } else {
                    3.0
                };
                lateness.is_late(&Touch::pressing(force_n), 0.0)
            });
            assert_eq!(late, expected, "{lasts} cycles");
        }
    }

    #[test]
    fn a_force_that_rises_later_is_the_surfaces() {
        let mut lateness = Lateness::default();
        for k in 0..2000_u32 {
            let force_n = if k < 500 { 3.0 } else { 8.0 };
            assert!(!lateness.is_late(&Touch::pressing(force_n), 0.0));
        }
    }
}
