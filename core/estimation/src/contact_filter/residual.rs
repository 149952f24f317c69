//! How noisy a measurement is, learnt from its own innovations.
//!
//! Called by the contact filter. What changes slowly in an innovation is the state's error and none
//! of the noise's business, so only what is left above a slow mean counts.

/// Variance of a noise whose neighbouring samples are alike over one correlation length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residual {
    slow: f64,
    variance: f64,
    /// Correlation lengths seen since the start.
    seen: f64,
    floor: f64,
}

/// Least standard deviation, as a share of the one stated.
const FLOOR_SHARE: f64 = 0.02;
/// Memory, in correlation lengths.
const MEMORY: f64 = 15.0;

impl Residual {
    /// Believes in `sd` until something else was seen, and never in less than a fiftieth of it.
    pub fn new(sd: f64) -> Self {
        Self {
            slow: 0.0,
            variance: sd * sd,
            seen: 0.0,
            floor: (FLOOR_SHARE * sd).powi(2),
        }
    }

    /// Takes an innovation; `step` is the way or time since the one before, in correlation lengths.
    pub fn learn(&mut self, innovation: f64, step: f64) {
        let step = step.min(1.0);
        if self.seen == 0.0 {
            self.slow = innovation;
        }
        self.seen += step;
        self.slow += step / (1.0 + step) * (innovation - self.slow);
        let quick = innovation - self.slow;
        // A mean over one correlation length leaves half of the variance of noise of that length.
        let share = step / MEMORY;
        self.variance += share * (2.0 * quick * quick - self.variance);
        self.variance = self.variance.max(self.floor);
    }

    /// In the innovation's unit, squared.
    pub fn variance(&self) -> f64 {
        self.variance
    }
}
