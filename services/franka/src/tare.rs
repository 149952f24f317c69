//! The zero of the robot's wrench estimate: the mean over a quarter of a second, subtracted until the next tare.
//!
//! The estimate is off by some newtons, and by how many depends on the pose; a controller asks for a tare where it is about to
//! touch.

use nalgebra::Vector6;

/// States over which the mean is taken.
const SAMPLES: u32 = 250;

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

    /// One wrench (N, Nm); true when a tare became complete with it.
    pub fn take(&mut self, wrench: &Vector6<f64>, now_s: f64) -> bool {
        if self.left == 0 {
            return false;
        }
        self.sum += wrench;
        self.left -= 1;
        if self.left > 0 {
            return false;
        }
        self.bias = self.sum / f64::from(SAMPLES);
        self.taken_s = Some(now_s);
        true
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
        assert!(!tare.take(&Vector6::repeat(9.0), 0.0));
        assert_eq!(tare.age_s(1.0), -1.0);
        tare.start();
        let done = (0..SAMPLES)
            .map(|i| tare.take(&Vector6::repeat(f64::from(i % 2)), 2.0))
            .filter(|done| *done)
            .count();
        assert_eq!(done, 1);
        assert_eq!(*tare.bias(), Vector6::repeat(0.5));
        assert_eq!(tare.age_s(3.0), 1.0);
    }
}
