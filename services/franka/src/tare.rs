//! The zero of the robot's wrench estimate: the mean over a quarter of a second, subtracted until the next tare.
//!
//! The estimate is off by some newtons, and by how many depends on the pose; a controller asks for a tare where it is about to
//! touch.

use nalgebra::Vector6;

/// States over which the mean is taken.
const SAMPLES: u32 = 250;

/// A zero beyond is a touch, or a load that the robot was told wrongly, N: the estimate of an arm at rest is never so far off.
pub const ZERO_MAX_N: f64 = 5.0;

/// A zero that was refused: the mean that was taken, N.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the robot feels {force_n:.1} N at rest, at most {ZERO_MAX_N} N can be its zero: the tool touches something, or the load set in Desk is wrong"
)]
pub struct ZeroTooLarge {
    /// Size of the mean.
    pub force_n: f64,
}

/// See the module.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tare {
    bias: Vector6<f64>,
    taken_s: Option<f64>,
    sum: Vector6<f64>,
    left: u32,
}

impl Tare {
    /// Takes the mean from now on.
    pub fn start(&mut self) {
        self.sum = Vector6::zeros();
        self.left = SAMPLES;
    }

    /// The mean being taken comes to nothing; the zero before stays in force.
    pub fn cancel(&mut self) {
        self.left = 0;
    }

    /// One wrench (N, Nm); how the tare ended when it became complete with it. A refused one leaves the zero before in force.
    pub fn take(&mut self, wrench: &Vector6<f64>, now_s: f64) -> Option<Result<(), ZeroTooLarge>> {
        if self.left == 0 {
            return None;
        }
        self.sum += wrench;
        self.left -= 1;
        if self.left > 0 {
            return None;
        }
        let mean = self.sum / f64::from(SAMPLES);
        let force_n = mean.fixed_rows::<3>(0).norm();
        if force_n.is_nan() || force_n > ZERO_MAX_N {
            return Some(Err(ZeroTooLarge { force_n }));
        }
        self.bias = mean;
        self.taken_s = Some(now_s);
        Some(Ok(()))
    }

    /// What is subtracted, N, Nm.
    pub fn bias(&self) -> &Vector6<f64> {
        &self.bias
    }

    /// Since it was taken, s; negative when it never was.
    pub fn age_s(&self, now_s: f64) -> f64 {
        self.taken_s.map_or(-1.0, |taken_s| now_s - taken_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_what_comes_after_the_start_is_the_zero() {
        let mut tare = Tare::default();
        assert_eq!(tare.take(&Vector6::repeat(9.0), 0.0), None);
        assert_eq!(tare.age_s(1.0), -1.0);
        tare.start();
        let done = (0..SAMPLES)
            .map(|i| tare.take(&Vector6::repeat(f64::from(i % 2)), 2.0))
            .filter(|done| *done == Some(Ok(())))
            .count();
        assert_eq!(done, 1);
        assert_eq!(*tare.bias(), Vector6::repeat(0.5));
        assert_eq!(tare.age_s(3.0), 1.0);
    }

    #[test]
    fn a_tare_of_a_tool_that_presses_is_refused_and_the_zero_before_stays() {
        let mut tare = Tare::default();
        let mut taken = |z: f64| {
            tare.start();
            let pressing = Vector6::new(0.5, 0.0, z, 0.0, 0.0, 0.0);
            let ended = (0..SAMPLES)
                .filter_map(|_| tare.take(&pressing, 1.0))
                .next_back();
            (ended, tare.bias().z)
        };
        assert_eq!(taken(-1.5), (Some(Ok(())), -1.5));
        let (ended, zero) = taken(-9.0);
        assert!(matches!(ended, Some(Err(ZeroTooLarge { force_n })) if force_n > 9.0));
        assert_eq!(zero, -1.5);
    }
}
