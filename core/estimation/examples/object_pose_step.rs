//! Duration of one update of the object-pose estimators: microseconds per cycle with a frame, in
//! contact, and with neither.
//!
//! `cargo run --release -p tangent-estimation --example object_pose_step`
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::hint::black_box;
use std::time::Instant;

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use tangent_estimation::object_pose::{
    CameraFrame, CameraModel, Corner, OBJECT_ESTIMATORS, ObjectPoseConfig, ObjectSample,
    build_object_estimator,
};
use tangent_mechanics::{Object, Pose, Wrench};
use tangent_sensing::Validity;

fn main() {
    let camera = CameraModel {
        flange_from_camera: Pose::new(Vector3::new(0.07, 0.0, -0.05), UnitQuaternion::identity()),
        focal_px: 400.0,
        principal_px: Vector2::new(320.0, 240.0),
        pixel_m: 2e-5,
    };
    let mut config = ObjectPoseConfig::default();
    // An update with force and joints in every cycle, to measure its duration.
    config.contact.period_s = 0.0;
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    println!("| estimator | cycle | median us | p99 us |");
    println!("|---|---|---|---|");
    for name in OBJECT_ESTIMATORS {
        for (kind, frames, touches) in [
            ("neither", false, false),
            ("touch", false, true),
            ("four corners", true, false),
            ("four corners and touch", true, true),
        ] {
            let Ok(mut estimator) = build_object_estimator(name, &config, &camera) else {
                return;
            };
            let mut times = Vec::new();
            for step in 0..20_000_u32 {
                let time_s = f64::from(step) * 0.02;
                let sway = (time_s * 0.7).sin();
                let base_from_flange =
                    Pose::new(Vector3::new(-0.1 + 0.02 * sway, 0.01, 0.25), down);
                let tool = Pose::new(Vector3::new(0.0, 0.0, 0.25), UnitQuaternion::identity());
                let base_from_object: Pose<_, Object> = Pose::identity();
                let camera_from_object =
                    (base_from_flange * camera.flange_from_camera).inverse() * base_from_object;
                let frame = CameraFrame {
                    time_s,
                    sequence: u64::from(step),
                    corners: config.target.corners().map(|corner| {
                        camera
                            .project(&camera_from_object.transform_point(&corner))
                            .map(|pixel_px| Corner { pixel_px })
                    }),
                };
                // The first frame starts the estimator; later frames come as stated in the row.
                let sample = ObjectSample {
                    time_s,
                    base_from_flange,
                    base_from_tool: base_from_flange * tool,
                    wrench: Wrench::new(
                        Vector3::new(0.0, 0.0, if touches { -20.0 } else { 0.0 }),
                        Vector3::zeros(),
                    ),
                    wrench_delay_s: 0.0,
                    wrench_validity: Validity::Valid,
                    wrench_bias_age_s: Some(1.0),
                    frame: (frames || step < 5).then_some(frame),
                };
                let start = Instant::now();
                black_box(estimator.update(black_box(&sample)));
                times.push(start.elapsed().as_nanos() as f64 * 1e-3);
            }
            times.sort_by(f64::total_cmp);
            println!(
                "| `{name}` | {kind} | {:.2} | {:.2} |",
                times[times.len() / 2],
                times[times.len() * 99 / 100]
            );
        }
    }
}
