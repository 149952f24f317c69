//! Noise of the force along the approach while the tool moves in free space: a touch must stand out
//! of it.
//!
//! Called by the senses in each cycle of the approach. Vibration, coloured noise and the cable
//! differ from arm to arm; with a light force they reach a threshold that is a share of it.

/// Time constant of the mean, s: slower than a vibration, faster than the drift of the zero.
const MEAN_S: f64 = 0.3;
/// Time constant of the variance, s.
const VARIANCE_S: f64 = 1.0;
/// Standard deviation assumed before anything was measured, N.
const FIRST_SD_N: f64 = 0.06;
/// Standard deviations that no noise reaches in the seconds of an approach.
const SDS: f64 = 4.5;
/// Largest threshold for that reason, as a share of the reference.
const SHARE_MAX: f64 = 0.6;

/// State for one approach. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FreeNoise {
    mean_n: Option<f64>,
    variance_n2: f64,
}

impl FreeNoise {
    /// Adds one cycle's force along the approach, N, with the tool in free space.
    pub fn add(&mut self, force_n: f64, dt_s: f64) {
        let Some(mean_n) = &mut self.mean_n else {
            (self.mean_n, self.variance_n2) = (Some(force_n), FIRST_SD_N * FIRST_SD_N);
            return;
        };
        *mean_n += (force_n - *mean_n) * (dt_s / (dt_s + MEAN_S));
        let off_n = force_n - *mean_n;
        self.variance_n2 += (off_n * off_n - self.variance_n2) * (dt_s / (dt_s + VARIANCE_S));
    }

    /// Lowest force that is a touch and not noise, N; 0 before an approach.
    pub fn touch_n(&self, reference_n: f64) -> f64 {
        (SDS * self.variance_n2.sqrt()).min(SHARE_MAX * reference_n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The threshold after 4 s of a vibration of this amplitude (N) at 12 Hz.
    fn threshold_n(amplitude_n: f64, reference_n: f64) -> f64 {
        let mut noise = FreeNoise::default();
        for k in 0..500 {
            let t = 0.008 * f64::from(k);
            noise.add(
                amplitude_n * (std::f64::consts::TAU * 12.0 * t).sin(),
                0.008,
            );
        }
        noise.touch_n(reference_n)
    }

    /// The bug: a vibration of 0.3 N was taken for the surface, again and again, until the task
    /// ended because the surface did, without ever having touched one.
    #[test]
    fn a_vibration_is_no_touch() {
        assert!(threshold_n(0.3, 3.0) > 0.6);
        assert!(threshold_n(0.01, 3.0) < 0.06);
    }

    #[test]
    fn a_touch_is_felt_below_the_reference() {
        assert!(threshold_n(2.0, 1.0) < 0.7);
    }
}
