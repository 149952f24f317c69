//! First motion after a touch: the law waits until the motion already commanded has taken effect,
//! and moves back meanwhile.
//!
//! Called by the force law each cycle from a touch on. A tool that moves in at `v` goes `v T`
//! deeper after the touch, `T` being the loop's delay. Moving back at `v` for less than `T`
//! therefore leaves a part of that depth: the contact stays. A delay assumed too long would move
//! the tool off the surface, so the motion back is made for the shortest delay in question, and it
//! ends as soon as the force has been seen to fall.

/// Duration of the motion back as a share of the shortest delay. An arm with lag then stops sooner,
/// and ends where it touched the surface instead of a whole delay deeper.
const BACK_SHARE: f64 = 0.6;
/// Duration of the whole wait as a share of the longest delay.
const WAIT_SHARE: f64 = 1.5;
/// Fall of the force below its peak that ends the motion back, as a share of the peak, and at
/// least, N: more than noise.
const FALLEN_SHARE: f64 = 0.15;
const FALLEN_N: f64 = 0.2;

/// Remaining motion after a touch. The default has none.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Recoil {
    speed_m_per_s: f64,
    back_s: f64,
    wait_s: f64,
    peak_n: f64,
}

impl Recoil {
    /// After a touch with `force_n` (N) at `speed_m_per_s`, in a loop with a delay between
    /// `shortest_s` and `longest_s`.
    pub fn new(force_n: f64, speed_m_per_s: f64, shortest_s: f64, longest_s: f64) -> Self {
        Self {
            speed_m_per_s,
            back_s: BACK_SHARE * shortest_s,
            wait_s: WAIT_SHARE * longest_s,
            peak_n: force_n,
        }
    }

    /// Whether the wait is over and the force decides.
    pub fn is_over(&self) -> bool {
        self.wait_s <= 0.0
    }

    /// Processes one cycle with the force `force_n` (N). Returns the speed out of the material, m/s
    /// (0: stand); `None` once the wait is over and the force decides.
    pub fn step(&mut self, force_n: f64, dt_s: f64) -> Option<f64> {
        if self.is_over() {
            return None;
        }
        self.wait_s -= dt_s;
        self.peak_n = self.peak_n.max(force_n);
        if self.peak_n - force_n > FALLEN_N.max(FALLEN_SHARE * self.peak_n) {
            self.back_s = 0.0;
        }
        if self.back_s <= 0.0 {
            return Some(0.0);
        }
        self.back_s -= dt_s;
        Some(self.speed_m_per_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_back_for_the_shortest_delay_and_waits_for_the_longest() {
        let mut recoil = Recoil::new(0.6, 0.002, 0.02, 0.06);
        let (mut back_m, mut waited_s) = (0.0, 0.0);
        while let Some(speed) = recoil.step(0.8, 0.002) {
            back_m += speed * 0.002;
            waited_s += 0.002;
        }
        assert!((back_m - 0.002 * 0.012).abs() < 1e-9, "{back_m}");
        assert!((waited_s - 0.09f64).abs() < 0.003, "{waited_s}");
    }

    #[test]
    fn a_fallen_force_ends_the_motion_back_but_not_the_wait() {
        let mut recoil = Recoil::new(0.6, 0.002, 0.06, 0.06);
        assert_eq!(recoil.step(2.0, 0.002), Some(0.002));
        assert_eq!(recoil.step(1.9, 0.002), Some(0.002));
        assert_eq!(recoil.step(1.6, 0.002), Some(0.0));
        assert_eq!(recoil.step(2.0, 0.002), Some(0.0));
    }
}
