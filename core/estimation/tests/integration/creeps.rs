//! A tool that moves more slowly than an estimator calls sliding.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use tangent_estimation::{ContactSample, EstimatorConfig, NormalEstimate, build};
use tangent_mechanics::{Pose, Twist, Wrench};
use tangent_sensing::Validity;

use crate::noise::gaussian;

const DT_S: f64 = 0.008;
const LOAD_N: f64 = 3.0;
const STIFFNESS_N_PER_M: f64 = 20_000.0;
const FRICTION: f64 = 0.3;
/// Way over a plane, m, which bends to a cylinder of this radius, m.
const PLANE_M: f64 = 0.03;
const RADIUS_M: f64 = 0.1;

/// Place of the surface and angle of its normal after a way along it.
fn surface(way_m: f64) -> (Vector3<f64>, f64) {
    let angle = (way_m - PLANE_M).max(0.0) / RADIUS_M;
    let x = way_m.min(PLANE_M) + RADIUS_M * angle.sin();
    (Vector3::new(x, 0.0, RADIUS_M * (angle.cos() - 1.0)), angle)
}

fn normal(angle: f64) -> Vector3<f64> {
    Vector3::new(angle.sin(), 0.0, angle.cos())
}

/// The estimate at the end of a way that leads over the plane at 20 mm/s and `creeps_m` around the
/// cylinder at `speed_m_per_s`, with a square tool; and the true normal there.
fn after(creeps_m: f64, speed_m_per_s: f64, seed: u64) -> (NormalEstimate, Vector3<f64>) {
    let mut noise = gaussian(seed);
    let mut estimator = build("reactive", &EstimatorConfig::default()).unwrap();
    let (mut time_s, mut way_m, mut load_n) = (0.0, 0.0, 0.0_f64);
    loop {
        time_s += DT_S;
        let speed = match (time_s < 1.5, way_m < PLANE_M) {
            (true, _) => 0.0,
            (_, true) => 0.02,
            _ => speed_m_per_s,
        };
        let before = surface(way_m);
        way_m += speed * DT_S;
        load_n = (load_n + LOAD_N * DT_S).min(LOAD_N);
        let (place, angle) = surface(way_m);
        let up = normal(angle);
        let along = Vector3::new(angle.cos(), 0.0, -angle.sin());
        let sinks_m_per_s = if load_n < LOAD_N {
            LOAD_N / STIFFNESS_N_PER_M
        } else {
            0.0
        };
        let rotation = Rotation3::from_axis_angle(&Vector3::y_axis(), angle + std::f64::consts::PI);
        let friction_n = if speed > 0.0 { FRICTION * load_n } else { 0.0 };
        let force = up * load_n - along * friction_n;
        let twist = Twist::new(
            (place - before.0) / DT_S - up * sinks_m_per_s,
            Vector3::y() * ((angle - before.1) / DT_S),
        );
        let position = place - up * (load_n / STIFFNESS_N_PER_M);
        let estimate = estimator.update(&ContactSample {
            time_s,
            dt_s: DT_S,
            base_from_tool: Pose::new(position, UnitQuaternion::from_rotation_matrix(&rotation)),
            twist,
            twist_commanded: twist,
            wrench: Wrench::new(
                rotation.inverse() * force.map(|f| f + noise(0.03)),
                Vector3::zeros(),
            ),
            wrench_delay_s: 0.0,
            wrench_validity: Validity::Valid,
            wrench_bias_age_s: Some(time_s),
            base: None,
        });
        if way_m >= PLANE_M + creeps_m {
            return (estimate, up);
        }
    }
}

/// Its normal was carried on with the curvature of the plane before: 17 degrees off here.
#[test]
fn a_creeping_tool_feels_the_slope_as_a_sliding_one_does() {
    for seed in 1..=5 {
        let [slides, creeps] = [0.02, 0.001].map(|speed_m_per_s| {
            let (estimate, up) = after(0.03, speed_m_per_s, seed);
            assert_eq!(estimate.validity, Validity::Valid);
            estimate.normal.angle(&up).to_degrees()
        });
        assert!(slides < 4.0, "{slides}");
        assert!(creeps < 8.0, "{creeps}");
    }
}

/// A tool that stands learns nothing of the slope, however long.
#[test]
fn a_tool_that_hardly_moves_grows_no_surer() {
    let sd = |creeps_m: f64| {
        let (estimate, _) = after(creeps_m, 2e-5, 7);
        estimate.covariance.trace().sqrt()
    };
    let (soon, late) = (sd(1e-5), sd(2e-4));
    assert!(late >= 0.95 * soon, "{soon} {late}");
}
