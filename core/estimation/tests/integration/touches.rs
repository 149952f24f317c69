//! A tool that touches a surface at some places, and slides nowhere.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tangent_estimation::{EstimatorConfig, NormalEstimate, build};
use tangent_mechanics::{Pose, Twist, Wrench};
use tangent_sensing::Validity;

use crate::noise::gaussian;
use crate::samples::sample;

const DT: f64 = 0.008;
const STIFFNESS: f64 = 50_000.0;
const LOAD_N: f64 = 1.5;
/// Standard deviation of the height of one place: roughness and gears, m.
const ROUGH_M: f64 = 15e-6;
/// Height above the surface at which the tool moves across, m.
const ABOVE_M: f64 = 0.0015;

/// The last estimate in contact after touches at `places` (m along the surface's plane), each for
/// `pressed_s`, of a plane with this normal and a tool that points down.
fn touched(
    places: &[(f64, f64)],
    normal: &Vector3<f64>,
    pressed_s: f64,
    seed: u64,
) -> NormalEstimate {
    let mut noise = gaussian(seed);
    let mut estimator = build("reactive", &EstimatorConfig::default()).unwrap();
    let down =
        Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)));
    let height = |x: f64, y: f64| -(normal.x * x + normal.y * y) / normal.z;
    // Way points of the tool: position, time to get there, and height of the rough surface there.
    let (x, y) = places[0];
    let mut way = vec![(Vector3::new(x, y, ABOVE_M), 0.0, 0.0)];
    for &(x, y) in places {
        let z = height(x, y) + noise(ROUGH_M);
        let at = |above_m: f64, lasts_s: f64| (Vector3::new(x, y, z + above_m), lasts_s, z);
        let deep_m = LOAD_N / STIFFNESS;
        way.extend([
            at(ABOVE_M, 0.6),
            at(-deep_m, 0.8),
            at(-deep_m, pressed_s),
            at(ABOVE_M, 0.3),
        ]);
    }
    let mut last = None;
    let mut time_s = 0.0;
    for pair in way.windows(2) {
        let ((from, ..), (to, lasts_s, surface_m)) = (pair[0], pair[1]);
        let steps = (lasts_s / DT).ceil();
        for step in 1..=steps as usize {
            time_s += DT;
            let position = from.lerp(&to, step as f64 / steps);
            let deep_m = surface_m - position.z;
            let twist = Twist::new((to - from) / lasts_s, Vector3::zeros());
            // Friction holds the tip: the force points along the tool.
            let force = Vector3::z() * -(STIFFNESS * deep_m).max(0.0);
            let estimate = estimator.update(&sample(
                time_s,
                DT,
                Pose::new(position, UnitQuaternion::from_rotation_matrix(&down)),
                twist,
                Wrench::new(force.map(|f| f + noise(0.03)), Vector3::zeros()),
            ));
            if estimate.validity != Validity::NoContact {
                last = Some(estimate);
            }
        }
    }
    last.unwrap()
}

fn off_deg(estimate: &NormalEstimate, normal: &Vector3<f64>) -> f64 {
    estimate.normal.angle(normal).to_degrees()
}

/// Corners of a triangle around the first place, and that place again.
const TRIANGLE: [(f64, f64); 5] = [
    (0.0, 0.0),
    (3e-3, 0.0),
    (-1.5e-3, 2.6e-3),
    (-1.5e-3, -2.6e-3),
    (0.0, 0.0),
];

#[test]
fn heights_of_some_places_show_the_slope_without_sliding() {
    let mut nees = 0.0;
    let mut count = 0.0;
    for direction in 0..8 {
        let angle = f64::from(direction) * 0.8;
        let axis = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let normal = Rotation3::from_scaled_axis(axis * 0.25) * Vector3::z();
        let before = touched(&TRIANGLE[..1], &normal, 0.6, 1);
        assert!(off_deg(&before, &normal) > 8.0);
        let after = touched(&TRIANGLE, &normal, 0.6, 10 + direction as u64);
        assert!(
            off_deg(&after, &normal) < 1.5,
            "{}",
            off_deg(&after, &normal)
        );
        let sd_deg = (after.covariance.trace() / 2.0).sqrt().to_degrees();
        assert!(sd_deg < 2.6, "{sd_deg}");
        let n = after.normal;
        let error = normal - n * n.dot(&normal);
        let full = after.covariance + n * n.transpose();
        nees += error.dot(&(full.try_inverse().unwrap() * error)) / 2.0;
        count += 1.0;
    }
    let nees = nees / count;
    assert!((0.02..2.0).contains(&nees), "{nees}");
}

#[test]
fn touches_at_one_place_show_no_slope() {
    let normal = Rotation3::from_scaled_axis(Vector3::x() * 0.25) * Vector3::z();
    let here = touched(&[(0.0, 0.0); 5], &normal, 0.6, 3);
    assert!(off_deg(&here, &normal) > 8.0);
    let sd_deg = (here.covariance.trace() / 2.0).sqrt().to_degrees();
    assert!(sd_deg > 4.0, "{sd_deg}");
}
