//! A tool that moves more slowly than an estimator calls sliding.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use tangent_estimation::{EstimatorConfig, NormalEstimate, build};
use tangent_mechanics::{Pose, Twist, Wrench};
use tangent_sensing::Validity;

use crate::noise::gaussian;
use crate::samples::sample;

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

/// The estimate after a way of a square tool that leads over the plane at 20 mm/s, and then on at
/// the speed (m/s) that `motion` gives for the time since (s) and the way since (m) until it gives
/// none; and the true normal there.
fn after(motion: impl Fn(f64, f64) -> Option<f64>, seed: u64) -> (NormalEstimate, Vector3<f64>) {
    let mut noise = gaussian(seed);
    let mut estimator = build("reactive", &EstimatorConfig::default()).unwrap();
    let (mut time_s, mut way_m, mut load_n) = (0.0, 0.0, 0.0_f64);
    let (mut estimate, mut up) = (None, Vector3::z());
    let mut since_s = None;
    loop {
        time_s += DT_S;
        let speed = match since_s {
            _ if time_s < 1.5 => 0.0,
            None if way_m < PLANE_M => 0.02,
            _ => {
                let since_s = *since_s.get_or_insert(time_s);
                match motion(time_s - since_s, way_m - PLANE_M) {
                    Some(speed) => speed,
                    None => return (estimate.unwrap(), up),
                }
            }
        };
        let before = surface(way_m);
        way_m += speed * DT_S;
        load_n = (load_n + LOAD_N * DT_S).min(LOAD_N);
        let (place, angle) = surface(way_m);
        up = normal(angle);
        let along = Vector3::new(angle.cos(), 0.0, -angle.sin());
        let sinks_m_per_s = if load_n < LOAD_N {
            LOAD_N / STIFFNESS_N_PER_M
        } else {
            0.0
        };
        let rotation = Rotation3::from_axis_angle(&Vector3::y_axis(), angle + std::f64::consts::PI);
        let friction_n = if speed == 0.0 {
            0.0
        } else {
            FRICTION * load_n * speed.signum()
        };
        let force = up * load_n - along * friction_n;
        let twist = Twist::new(
            (place - before.0) / DT_S - up * sinks_m_per_s,
            Vector3::y() * ((angle - before.1) / DT_S),
        );
        let position = place - up * (load_n / STIFFNESS_N_PER_M);
        estimate = Some(estimator.update(&sample(
            time_s,
            DT_S,
            Pose::new(position, UnitQuaternion::from_rotation_matrix(&rotation)),
            twist,
            Wrench::new(
                rotation.inverse() * force.map(|f| f + noise(0.03)),
                Vector3::zeros(),
            ),
        )));
    }
}

/// Its normal was carried on with the curvature of the plane before: 17 degrees off here.
#[test]
fn a_creeping_tool_feels_the_slope() {
    for seed in 1..=5 {
        let [slides, creeps] = [0.02, 0.001].map(|speed_m_per_s| {
            let around = |_, way_m: f64| (way_m < 0.03).then_some(speed_m_per_s);
            let (estimate, up) = after(around, seed);
            assert_eq!(estimate.validity, Validity::Valid);
            estimate.normal.angle(&up).to_degrees()
        });
        assert!(slides < 4.0, "{slides}");
        assert!(creeps < 8.0, "{creeps}");
    }
}

/// A tool that shakes at its place learns nothing of the slope, however long.
#[test]
fn a_tool_that_shakes_at_its_place_grows_no_surer() {
    const AMPLITUDE_M: f64 = 8e-5;
    const RATE_RAD_PER_S: f64 = 18.0;
    let sd = |seconds: f64| {
        let shakes = |time_s: f64, _| {
            let speed = AMPLITUDE_M * RATE_RAD_PER_S * (RATE_RAD_PER_S * time_s).cos();
            (time_s < seconds).then_some(speed)
        };
        after(shakes, 7).0.covariance.trace().sqrt()
    };
    let (soon, late) = (sd(0.5), sd(30.0));
    assert!(late >= 0.95 * soon, "{soon} {late}");
}
