//! How well the memory predicts the surface of the present pass, compared with the estimated
//! normal: a part that was exchanged shows within millimetres.

use nalgebra::Vector3;

use crate::contact::alignment::tangential;

/// Distance over which the direction of the surface is measured, m.
const STEP_M: f64 = 0.002;
/// Share of a new measurement in the mean squares.
const GAIN: f64 = 0.25;
/// Share of a new measurement in the slow mean square of the memory: two surfaces cross somewhere,
/// and the memory of the other one is right there for some millimetres.
const GAIN_SLOW: f64 = 0.05;
/// Slope error below which the comparison means nothing.
const FLOOR: f64 = 0.01;
/// Number of measurements in a pass after which the memory's normal is used in full.
const CONFIRMED_BY: f64 = 4.0;
/// Slope errors before the first measurement: of the memory and of the estimated normal.
const FIRST: (f64, f64) = (0.015, 0.02);

#[derive(Clone, Copy, Debug)]
struct Checkpoint {
    position: Vector3<f64>,
    normal: Vector3<f64>,
}

/// Mean squares of the slope errors of both predictions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trust {
    memory: f64,
    memory_slow: f64,
    estimated: f64,
    last: Option<Checkpoint>,
    /// Number of measurements in this pass.
    count: f64,
}

impl Default for Trust {
    fn default() -> Self {
        Self {
            memory: FIRST.0 * FIRST.0,
            memory_slow: 0.0,
            estimated: FIRST.1 * FIRST.1,
            last: None,
            count: 0.0,
        }
    }
}

impl Trust {
    /// Starts anew at the next position: another stroke, or a lost contact.
    pub fn interrupt(&mut self) {
        self.last = None;
    }

    /// Takes the surface's point under the tool (m), the estimated normal and the tangent of the
    /// memory there.
    pub fn step(&mut self, point: &Vector3<f64>, normal: &Vector3<f64>, tangent: &Vector3<f64>) {
        let here = Checkpoint {
            position: *point,
            normal: *normal,
        };
        let last = *self.last.get_or_insert(here);
        let way = point - last.position;
        if way.norm() < STEP_M {
            return;
        }
        self.last = Some(here);
        self.count += 1.0;
        let Some(between) = (last.normal + normal).try_normalize(0.1) else {
            return;
        };
        // The part of the normal that is perpendicular to the memory's tangent.
        let Some(learnt) = tangential(&between, tangent).try_normalize(0.1) else {
            return;
        };
        let slope = |n: &Vector3<f64>| (way.dot(n) / way.norm()).powi(2);
        self.memory += (slope(&learnt) - self.memory) * GAIN;
        self.memory_slow += (slope(&learnt) - self.memory_slow) * GAIN_SLOW;
        self.estimated += (slope(&between) - self.estimated) * GAIN;
    }

    /// Share of the memory's normal that may be used, 0 to 1: it turns the tool at once, so it has
    /// to be confirmed by some measurements first.
    pub fn confirmed_share(&self) -> f64 {
        self.share() * (self.count / CONFIRMED_BY).min(1.0)
    }

    /// Share of the memory's feedforward that may be used, 0 to 1: all of it while its mean square
    /// error is below half of that of the estimated normal, nothing above 1.
    pub fn share(&self) -> f64 {
        let ratio = self.memory.max(self.memory_slow) / (self.estimated + FLOOR * FLOOR);
        (2.0 - 2.0 * ratio).clamp(0.0, 1.0)
    }
}
