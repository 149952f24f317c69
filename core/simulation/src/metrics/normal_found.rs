//! Travel on the surface until the estimated normal is near the true one.

use super::normals::angle_deg;
use super::sample::CycleSample;

/// Angle below which the normal counts as found, degrees.
const FOUND_DEG: f64 = 3.0;
/// Travel for which it has to stay so, m.
const FOUND_FOR_M: f64 = 0.005;

/// Travel below which the measured position may only be noise, m.
const TRAVEL_STEP_M: f64 = 2e-4;

/// Travel on the surface until the normal is found.
pub(super) fn after_m(span: &[CycleSample]) -> Option<f64> {
    let (mut travel, mut found_at) = (0.0, None);
    let mut anchor = span.first()?.tool_position;
    for sample in span.iter().filter(|s| s.touches()) {
        let truth = sample.truth?;
        let moved = sample.tool_position - anchor;
        let along = (moved - truth.normal * truth.normal.dot(&moved)).norm();
        if along > TRAVEL_STEP_M {
            travel += along;
            anchor = sample.tool_position;
        }
        let near = sample
            .estimate
            .is_some_and(|e| angle_deg(&e.normal, &truth.normal) < FOUND_DEG);
        if !near {
            found_at = None;
            continue;
        }
        let from = *found_at.get_or_insert(travel);
        if travel - from >= FOUND_FOR_M {
            return Some(from);
        }
    }
    found_at
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};
    use tangent_control::Phase;

    use super::*;
    use crate::metrics::{EstimateSample, TruthSample};

    /// A slide along x with the normal off by an angle that depends on the travel.
    fn slide(error_deg: impl Fn(f64) -> f64, length_m: f64) -> Vec<CycleSample> {
        let steps = (length_m / 1e-4).round() as usize;
        (0..=steps)
            .map(|i| {
                let x = i as f64 * 1e-4;
                let (sin, cos) = error_deg(x).to_radians().sin_cos();
                CycleSample {
                    time_s: i as f64 * 0.008,
                    phase: Phase::Slide,
                    estimate: Some(EstimateSample {
                        normal: Vector3::new(sin, 0.0, cos),
                        covariance: Matrix3::identity(),
                        valid: true,
                    }),
                    truth: Some(TruthSample {
                        normal: Vector3::z(),
                        tool_z: -Vector3::z(),
                        in_contact: true,
                        force_n: 3.0,
                    }),
                    tool_position: Vector3::new(x, 0.0, 0.0),
                    tool_z: -Vector3::z(),
                    force_n: Some(3.0),
                    force_reference_n: 3.0,
                    in_contact: true,
                    path_reference: Vector3::zeros(),
                    path_error_m: 0.0,
                    joint_speed_rad_per_s: 0.0,
                    manipulability: 1.0,
                    motion_tank_j: None,
                    force_tank_j: None,
                }
            })
            .collect()
    }

    #[test]
    fn it_is_found_where_it_stays_near_for_long_enough() {
        let settles = slide(|x| 10.0 * (-x / 0.01).exp(), 0.05);
        // 10 exp(-x / 10 mm) is 3 at 12 mm.
        let found = after_m(&settles).unwrap();
        assert!((found - 0.01204).abs() < 3e-4, "{found}");
        // Near for 3 mm only, then far again.
        let passes = slide(
            |x| {
                if (0.01..0.013).contains(&x) {
                    0.0
                } else {
                    10.0
                }
            },
            0.03,
        );
        assert_eq!(after_m(&passes), None);
        // Near to the end, however short.
        let late = slide(|x| if x > 0.028 { 0.0 } else { 10.0 }, 0.03);
        assert!((after_m(&late).unwrap() - 0.028).abs() < 3e-4);
        assert_eq!(after_m(&[]), None);
    }
}
