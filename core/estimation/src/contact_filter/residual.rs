//! Estimates the noise of a measurement from its own innovations.
//!
//! Called by the contact filter. Slow changes of an innovation are errors of the state, not noise,
//! so only the deviation from a slow mean counts.

/// Variance of a noise that is correlated over one correlation length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residual {
    slow: f64,
    variance: f64,
    /// Number of correlation lengths since the start.
    seen: f64,
    floor: f64,
}

/// Averaging length, in correlation lengths.
const MEMORY: f64 = 15.0;

impl Residual {
    /// Starts with the standard deviation `sd`. The estimate never falls below `floor_share` of it.
    pub fn new(sd: f64, floor_share: f64) -> Self {
        Self {
            slow: 0.0,
            variance: sd * sd,
            seen: 0.0,
            floor: (floor_share * sd).powi(2),
        }
    }

    /// Adds an innovation; `step` is the distance or time since the previous one, in correlation
    /// lengths.
    pub fn learn(&mut self, innovation: f64, step: f64) {
        let step = step.min(1.0);
        if self.seen == 0.0 {
            self.slow = innovation;
        }
        self.seen += step;
        self.slow += step / (1.0 + step) * (innovation - self.slow);
        let quick = innovation - self.slow;
        // A mean over one correlation length leaves half of the variance of noise with that length.
        let share = step / MEMORY;
        self.variance += share * (2.0 * quick * quick - self.variance);
        self.variance = self.variance.max(self.floor);
    }

    /// Variance, in the innovation's unit squared.
    pub fn variance(&self) -> f64 {
        self.variance
    }
}
