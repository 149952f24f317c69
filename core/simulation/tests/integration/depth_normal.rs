//! Normals from the simulated depth camera: their error, their coverage of the image, and the
//! consistency of the covariance at the tool.

// A whole file of tests: what fails here is the test.
#![allow(
    clippy::unwrap_used,
    clippy::disallowed_macros,
    clippy::disallowed_methods
)]

use crate::depth_scenes::table::{Options, ours, side_by_side, take};
use crate::depth_scenes::{DepthScene, image, metres, scenes};
use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};
use tangent_estimation::depth_normal::{
    AheadEnd, DepthNormal, DepthNormalConfig, DepthNormalState, DepthSample, ToolTarget,
    VisualNormal, VisualValidity,
};
use tangent_mechanics::{Base, Flange, Pose, Tool};
use tangent_simulation::depth_camera::{
    DepthCamera, DepthCameraConfig, DepthNoiseConfig, ToolInViewConfig,
};
use tangent_simulation::{PoseConfig, ShapeConfig, Surface};

#[test]
fn errors_and_coverage_over_every_pixel_stay_within_the_goals() {
    let goals = [("cylinder", 0.50), ("sheet", 0.60), ("cone", 1.4)];
    for (size, focal, seed) in [
        ([640, 480], 385.0, 1),
        ([640, 480], 600.0, 2),
        ([848, 480], 425.0, 3),
    ] {
        for scene in scenes(size, focal, DepthNoiseConfig::default()) {
            let taken = take(&scene, seed);
            let row = ours(&scene, &taken, &DepthNormalConfig::default(), 1);
            println!("{size:?} {focal} {row:?}");
            let goal = goals
                .iter()
                .find(|(name, _)| *name == scene.name)
                .unwrap()
                .1;
            assert!(row.error_deg <= goal, "{row:?}");
            assert!(row.covered >= 0.99, "{row:?}");
        }
    }
}

#[test]
fn beside_pcl_on_the_same_frames() {
    let (table, rows) = side_by_side(&Options {
        repeats: 3,
        ..Options::default()
    });
    println!("{table}");
    for ours in rows.iter().filter(|r| r.method == "depth_normal") {
        for theirs in rows
            .iter()
            .filter(|r| r.scene == ours.scene && r.method.starts_with("PCL"))
        {
            assert!(ours.error_deg < theirs.error_deg, "{ours:?} {theirs:?}");
        }
    }
}

/// A camera 0.07 m beside the tool, which touches the surface 0.3 m below the flange.
fn over(
    surface: &Surface,
    at: Vector3<f64>,
    tilt: [f64; 2],
    turn: f64,
) -> (Pose<Base, Flange>, Pose<Flange, Tool>) {
    let flange_from_tool: Pose<Flange, Tool> =
        Pose::new(Vector3::new(0.0, 0.0, 0.3), UnitQuaternion::identity());
    let point = surface.query(&at).point;
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI + tilt[0], tilt[1], turn);
    let base_from_tool: Pose<Base, Tool> = Pose::new(point, down);
    (
        base_from_tool * flange_from_tool.inverse(),
        flange_from_tool,
    )
}

fn camera_config() -> DepthCameraConfig {
    DepthCameraConfig {
        flange_from_camera: PoseConfig {
            position_m: [0.07, 0.0, -0.02],
            roll_pitch_yaw_rad: [0.0, -0.15, 0.0],
        },
        tool: Some(ToolInViewConfig {
            radius_m: 0.012,
            length_m: 0.25,
        }),
        ..DepthCameraConfig::default()
    }
}

fn surfaces() -> Vec<(&'static str, Surface)> {
    let place = |shape: ShapeConfig, z: f64| {
        let pose = PoseConfig {
            position_m: [0.0, 0.0, z],
            roll_pitch_yaw_rad: [0.0, std::f64::consts::FRAC_PI_2, 0.3],
        };
        Surface::new(&shape, &pose).unwrap()
    };
    let flat = |shape: ShapeConfig| Surface::new(&shape, &PoseConfig::default()).unwrap();
    vec![
        ("plane", flat(ShapeConfig::Plane {})),
        (
            "cylinder",
            place(ShapeConfig::Cylinder { radius_m: 0.15 }, -0.15),
        ),
        (
            "sphere",
            place(ShapeConfig::Sphere { radius_m: 0.25 }, -0.25),
        ),
        (
            "sheet",
            flat(ShapeConfig::Sheet {
                amplitude_m: [0.0, 0.02],
                wavelength_m: [1.0, 0.38],
            }),
        ),
    ]
}

/// Estimates the surface at the tool's contact point, with the tool masked in the image.
fn look(
    surface: &Surface,
    base_from_flange: &Pose<Base, Flange>,
    flange_from_tool: &Pose<Flange, Tool>,
    seed: u64,
    travel_in_base: Option<Vector3<f64>>,
) -> (VisualNormal, Pose<Base, tangent_mechanics::Camera>) {
    let mut camera = DepthCamera::new(&camera_config(), flange_from_tool, seed).unwrap();
    let frame = camera.picture(0.0, 0, base_from_flange, surface);
    let base_from_camera = *base_from_flange * camera.flange_from_camera();
    let tool_in_camera = base_from_camera.inverse() * *base_from_flange * *flange_from_tool;
    let depth_m = metres(&frame);
    let mut mask = vec![0; depth_m.len()];
    tangent_estimation::depth_normal::leave_out_rod(
        &frame.intrinsics,
        [frame.width, frame.height],
        [
            &tool_in_camera.translation(),
            &(tool_in_camera.translation() - tool_in_camera.z_axis() * 0.25),
        ],
        0.012 + 0.006,
        &mut mask,
    );
    let sample = DepthSample {
        time_s: 0.25,
        image: image(&frame, &depth_m),
        intrinsics: frame.intrinsics,
        target: ToolTarget::Point(tool_in_camera.translation()),
        left_out: Some(&mask),
        travel: travel_in_base.map(|t| base_from_camera.unrotate(&t)),
    };
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    let found = step.update(&mut DepthNormalState::default(), &sample);
    (found, base_from_camera)
}

#[test]
fn the_covariance_at_the_tool_is_honest() {
    for (name, surface) in surfaces() {
        let (mut nees, mut errors) = (0.0, Vec::new());
        let runs = 60;
        for seed in 0..runs {
            let k = seed as f64;
            let at = Vector3::new(0.03 * (k * 0.7).sin(), 0.08 * (k * 1.3).cos(), 0.0);
            let tilt = [0.15 * (k * 0.37).sin(), 0.15 * (k * 0.53).cos()];
            let (flange, tool) = over(&surface, at, tilt, 0.1 * k);
            let (found, base_from_camera) = look(&surface, &flange, &tool, seed, None);
            assert_eq!(found.validity, VisualValidity::Valid, "{name} {seed}");
            let estimate = found.in_base(&base_from_camera);
            let truth = surface.query(&estimate.point).normal;
            // Error in the tangent plane, relative to the covariance there.
            let n = estimate.normal;
            let x = n.cross(&Vector3::x()).normalize();
            let y = n.cross(&x);
            let e = Vector2::new(x.dot(&truth), y.dot(&truth));
            let c = estimate.covariance;
            let p = Matrix2::new(
                x.dot(&(c * x)),
                x.dot(&(c * y)),
                y.dot(&(c * x)),
                y.dot(&(c * y)),
            );
            nees += e.dot(&(p.try_inverse().unwrap() * e)) / 2.0;
            errors.push(e.norm().to_degrees());
            assert!(estimate.validity.is_valid());
            assert!((c * n).norm() < 1e-9, "singular along the normal");
        }
        let nees = nees / runs as f64;
        errors.sort_by(f64::total_cmp);
        println!(
            "{name}: NEES per degree of freedom {nees:.2}, error median {:.2} deg, worst {:.2} deg",
            errors[30], errors[59]
        );
        // 60 runs with two degrees of freedom each: the mean for a consistent covariance is 1 +-
        // 0.13 (one sigma).
        assert!(nees > 0.4 && nees < 1.7, "{name}: {nees}");
        assert!(errors[30] < 0.3, "{name}: {errors:?}");
    }
}

#[test]
fn the_map_ahead_is_the_surface() {
    for (name, surface) in surfaces() {
        for seed in 0..5 {
            let (flange, tool) = over(&surface, Vector3::new(0.0, -0.05, 0.0), [0.1, -0.05], 0.4);
            let (found, base_from_camera) =
                look(&surface, &flange, &tool, seed, Some(Vector3::y()));
            assert_eq!(found.ahead.end, AheadEnd::Horizon, "{name}");
            let ahead = found.ahead.in_base(&base_from_camera);
            assert_eq!(ahead.stations.len(), 17);
            for pair in ahead.stations.windows(2) {
                let step = (pair[1].point - pair[0].point).norm();
                assert!((step - 0.005).abs() < 0.0015, "{name}: {step}");
            }
            for s in &ahead.stations {
                let truth = surface.query(&s.point);
                assert!(
                    truth.distance.abs() < 0.002,
                    "{name} {}: {}",
                    s.distance_m,
                    truth.distance
                );
                let error = truth.normal.cross(&s.normal).norm();
                let sd = (s.covariance.trace() / 2.0).sqrt();
                assert!(
                    error < 5.0 * sd,
                    "{name} at {}: {error} against {sd}",
                    s.distance_m
                );
                let along = (Vector3::y() - truth.normal * truth.normal.y).normalize();
                let bend = along.dot(&(truth.curvature * along));
                assert!(
                    (s.bend_per_m - bend).abs() < 5.0 * s.bend_sd_per_m,
                    "{name} at {}: {} +- {} against {bend}",
                    s.distance_m,
                    s.bend_per_m,
                    s.bend_sd_per_m
                );
            }
            assert!((ahead.at(0.0425).unwrap().distance_m - 0.0425).abs() < 1e-12);
            assert!(ahead.at(0.5).is_none());
        }
    }
}

#[test]
fn a_surface_that_ends_ends_the_map() {
    let surface = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
    let camera_config = DepthCameraConfig {
        extent_m: Some([[-0.2, -0.2, -0.1], [0.2, 0.03, 0.1]]),
        table_height_m: Some(-0.1),
        ..DepthCameraConfig::default()
    };
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    let scene = DepthScene {
        name: "edge",
        surface,
        camera: camera_config,
        base_from_flange: vec![Pose::new(Vector3::new(0.0, 0.0, 0.35), down)],
    };
    let taken = take(&scene, 5);
    let frame = &taken.frames[0];
    let depth_m = metres(frame);
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    let mut state = DepthNormalState::default();
    let mut look = |u: f64, v: f64, travel: Vector3<f64>| {
        step.update(
            &mut state,
            &DepthSample {
                time_s: 0.0,
                image: image(frame, &depth_m),
                intrinsics: frame.intrinsics,
                target: ToolTarget::Pixel([u, v]),
                left_out: None,
                travel: Some(travel),
            },
        )
    };
    // Base y points up in the image: the edge is 0.03 m above the middle, 33 pixels.
    let found = look(319.5, 239.5, -Vector3::y());
    assert_eq!(found.validity, VisualValidity::Valid);
    assert_eq!(found.ahead.end, AheadEnd::NotSeen);
    let last = found.ahead.stations.last().unwrap();
    assert!(last.distance_m <= 0.035, "{last:?}");
    // In the opposite direction, nothing ends the map.
    assert_eq!(
        look(319.5, 239.5, Vector3::y()).ahead.end,
        AheadEnd::Horizon
    );
    // The map ends near the image's border.
    assert_eq!(
        look(580.0, 300.0, Vector3::x()).ahead.end,
        AheadEnd::OutOfImage
    );
}
