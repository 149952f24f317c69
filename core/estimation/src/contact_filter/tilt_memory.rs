//! What the torque of a pad has shown of its tilt since the touch.

use nalgebra::Vector3;

/// Time over which the centre of pressure is averaged, s, and the force above which it is less: the
/// tool turns meanwhile, and at a strong force the torque is less noisy.
const MEAN_S: f64 = 0.04;
const MEAN_AT_N: f64 = 4.0;
/// Way along the surface after which a measurement of the tilt is forgotten, m.
const MEMORY_M: f64 = 0.02;
/// Way along the surface since a first touch within which the rim is looked at, m: later, the pad
/// may stand on its rim without being tilted, at the edge of a workpiece.
const RIM_WAY_M: f64 = 0.03;
/// Most of that way that is left once all of the pad has pressed, m.
const WHOLE_WAY_M: f64 = 0.015;

/// What the torque has shown of the tilt.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TiltMemory {
    /// Mean of the centre of pressure, tool axes, m.
    pub centre: Vector3<f64>,
    /// Time since the touch, or since the last look at the rim, s.
    pub since_s: f64,
    /// Information of the best measurement of the tilt, 1/rad².
    pub information: f64,
    /// Way along the surface since the normal was last forgotten, m; more once all of the pad has
    /// pressed.
    way_m: f64,
}

impl TiltMemory {
    /// Begins at a touch beside a surface that is known.
    pub fn touch_again(&mut self) {
        *self = Self {
            way_m: self.way_m,
            ..Self::default()
        };
    }

    /// Whether the rim may still be looked at.
    pub fn is_early(&self) -> bool {
        self.way_m < RIM_WAY_M
    }

    /// All of the pad presses.
    pub fn press_whole(&mut self) {
        self.way_m = self.way_m.max(RIM_WAY_M - WHOLE_WAY_M);
    }

    /// Begins a mean of its own for the next look at the rim.
    pub fn look_again(&mut self) {
        self.centre = Vector3::zeros();
        self.since_s = 0.0;
    }

    /// Averages the centre of pressure, and forgets with the way along the surface. Whether there
    /// is a mean.
    pub fn add(&mut self, centre_m: &Vector3<f64>, pressing_n: f64, way_m: f64, dt_s: f64) -> bool {
        self.way_m += way_m;
        self.information *= (-way_m / MEMORY_M).exp();
        self.since_s += dt_s;
        let mean_s = MEAN_S * (MEAN_AT_N / pressing_n).min(1.0);
        let gain = (dt_s / self.since_s.min(mean_s)).min(1.0);
        self.centre += (centre_m - self.centre) * gain;
        self.since_s >= mean_s
    }
}
