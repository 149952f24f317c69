//! Detection of contact, and the direction of the force: eq. (18).

use nalgebra::Vector3;

use super::{ContactNoiseConfig, ObjectSample};

/// Contact force of one cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// Direction n_h of eq. (18), base axes.
    pub direction: Vector3<f64>,
    /// Pressing force, N.
    pub force_n: f64,
}

/// Detects contact, with a hysteresis.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TouchDetector {
    touching: bool,
}

impl TouchDetector {
    /// `normal` is the best available estimate of the surface normal, base axes. A force
    /// perpendicular to it does not count as pressing.
    pub fn step(
        &mut self,
        config: &ContactNoiseConfig,
        sample: &ObjectSample,
        normal: &Vector3<f64>,
    ) -> Option<Touch> {
        let force = sample.base_from_tool.rotate(&sample.wrench.force);
        let usable = sample.wrench_validity.is_valid()
            && sample.wrench_bias_age_s.is_some()
            && force.iter().all(|x| x.is_finite());
        let threshold = if self.touching {
            config.force_off_n
        } else {
            config.force_on_n
        };
        self.touching = usable && force.dot(normal) >= threshold;
        self.touching.then(|| {
            let force_n = force.norm();
            Touch {
                direction: force / force_n,
                force_n,
            }
        })
    }

    pub fn touching(&self) -> bool {
        self.touching
    }
}

/// Speed of the tip below which friction may have any direction, m/s.
const SLIDING_M_PER_S: f64 = 2e-3;
/// Distance in one direction after which friction is opposed to it, m.
const PRESLIDING_M: f64 = 5e-4;
/// Cosine of the angle beyond which a new direction begins.
const SAME_DIRECTION: f64 = 0.9;

/// Tracks the sliding direction of the tip between updates.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SlideTracker {
    last: Option<(f64, Vector3<f64>)>,
    direction: Vector3<f64>,
    way_m: f64,
}

impl SlideTracker {
    /// Time of the last update, s.
    pub fn last_s(&self) -> Option<f64> {
        self.last.map(|(at, _)| at)
    }

    /// Direction of sliding (unit, base axes) once friction is opposed to it.
    pub fn step(&mut self, time_s: f64, tip: &Vector3<f64>) -> Option<Vector3<f64>> {
        let (at, from) = self.last.replace((time_s, *tip))?;
        let step = tip - from;
        let way = step.norm();
        if way <= SLIDING_M_PER_S * (time_s - at) {
            self.way_m = 0.0;
            return None;
        }
        let direction = step / way;
        if direction.dot(&self.direction) < SAME_DIRECTION {
            self.way_m = 0.0;
        }
        self.direction = direction;
        self.way_m += way;
        (self.way_m >= PRESLIDING_M).then_some(direction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sliding_begins_after_its_way_and_ends_at_rest_or_at_a_turn() {
        let mut slide = SlideTracker::default();
        let at = |x: f64, y: f64| Vector3::new(x, y, 0.0);
        assert_eq!(slide.step(0.0, &at(0.0, 0.0)), None);
        assert_eq!(slide.step(0.01, &at(2e-4, 0.0)), None, "not far enough");
        assert_eq!(slide.step(0.02, &at(6e-4, 0.0)), Some(Vector3::x()));
        assert_eq!(slide.step(0.03, &at(6e-4, 3e-4)), None, "turned");
        assert_eq!(slide.step(0.04, &at(6e-4, 8e-4)), Some(Vector3::y()));
        assert_eq!(slide.step(0.05, &at(6e-4, 8e-4)), None, "at rest");
    }
}
