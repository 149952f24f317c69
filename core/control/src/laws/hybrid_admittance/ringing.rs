//! Whether the force loop rings: swings of the force to both sides of its reference, larger than
//! noise, and faster than a surface makes them.
//!
//! Called by the force law each cycle. The law then takes the contact to be stiffer, whatever it
//! measured: the damping follows the stiffness, and a loop of too high a gain becomes quiet.

/// Error that counts as a swing, as a share of the reference, and at least, N: above vibration.
const SWING_SHARE: f64 = 0.35;
const SWING_N: f64 = 0.6;
/// Longest time between two swings to opposite sides, in delays of the loop: a loop at its limit of
/// stability swings to the other side every two delays, a well damped one not at all.
const APART_DELAYS: f64 = 6.0;
/// Swings to alternating sides that make a ringing loop.
const SWINGS: u32 = 3;

/// State of the detection. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ringing {
    /// Whether the last swing was above the reference; `None` before one.
    above: Option<bool>,
    since_s: f64,
    swings: u32,
}

impl Ringing {
    /// Processes one cycle with the force error `error_n` (N) in a loop of the delay `delay_s`;
    /// returns whether the loop rings. It then counts anew.
    pub fn step(&mut self, error_n: f64, reference_n: f64, delay_s: f64, dt_s: f64) -> bool {
        self.since_s += dt_s;
        if self.since_s > APART_DELAYS * delay_s {
            *self = Self::default();
        }
        if error_n.abs() < SWING_N.max(SWING_SHARE * reference_n) {
            return false;
        }
        let above = error_n > 0.0;
        if self.above != Some(above) {
            self.swings += 1;
            self.above = Some(above);
        }
        self.since_s = 0.0;
        if self.swings < SWINGS {
            return false;
        }
        *self = Self {
            above: self.above,
            ..Self::default()
        };
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rings(amplitude_n: f64, period_s: f64) -> bool {
        let mut ringing = Ringing::default();
        (0..1000).any(|i| {
            let t = f64::from(i) * 0.008;
            let error = amplitude_n * (std::f64::consts::TAU * t / period_s).sin();
            ringing.step(error, 3.0, 0.04, 0.008)
        })
    }

    #[test]
    fn swings_of_the_loops_own_period_are_ringing() {
        assert!(rings(2.0, 0.16));
        assert!(rings(2.0, 0.3));
    }

    #[test]
    fn noise_and_waves_of_the_surface_are_not() {
        assert!(!rings(0.8, 0.16));
        assert!(!rings(2.0, 1.5));
    }

    #[test]
    fn a_step_is_not() {
        let mut ringing = Ringing::default();
        assert!((0..200).all(|i| !ringing.step(
            if i < 100 { -2.0 } else { 2.0 },
            3.0,
            0.04,
            0.008
        )));
    }
}
