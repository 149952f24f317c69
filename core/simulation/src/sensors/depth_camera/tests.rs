//! Tests the rendering against the surfaces' distance functions, and each error of the camera
//! separately.

use nalgebra::{UnitQuaternion, Vector3};
use tangent_mechanics::{Base, Flange, Pose};

use super::*;
use crate::pose_config::PoseConfig;
use crate::surfaces::{Ray, ShapeConfig};

fn surface(shape: ShapeConfig) -> Surface {
    let pose = PoseConfig {
        position_m: [0.02, -0.01, 0.0],
        roll_pitch_yaw_rad: [0.2, 1.3, 0.4],
    };
    Surface::new(&shape, &pose).unwrap()
}

fn shapes() -> Vec<ShapeConfig> {
    let table = "y\\x,-0.1,-0.05,0.0,0.05,0.1\n-0.1,0,0,0.01,0,0\n-0.05,0,0.01,0.02,0.01,0\n0.0,0.01,0.02,0.03,0.02,0\n0.05,0,0.01,0.01,0.01,0\n0.1,0,0,0,0,0";
    vec![
        ShapeConfig::Plane {},
        ShapeConfig::Cylinder { radius_m: 0.12 },
        ShapeConfig::Cone {
            height_m: 0.3,
            base_radius_m: 0.1,
        },
        ShapeConfig::Sphere { radius_m: 0.2 },
        ShapeConfig::Torus {
            major_radius_m: 0.2,
            minor_radius_m: 0.05,
        },
        ShapeConfig::Sheet {
            amplitude_m: [0.01, 0.02],
            wavelength_m: [0.2, 0.3],
        },
        ShapeConfig::HeightField {
            csv: Some(table.to_owned()),
            csv_file: None,
        },
    ]
}

fn above(far: f64, roll: f64, pitch: f64) -> Pose<Base, Flange> {
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI + roll, pitch, 0.2);
    Pose::new(-(down * Vector3::z()) * far, down)
}

fn exact() -> DepthCameraConfig {
    DepthCameraConfig {
        image_px: [160, 120],
        focal_px: 100.0,
        noise: DepthNoiseConfig::none(),
        ..DepthCameraConfig::default()
    }
}

/// A ray ends on the surface, coming from outside, and nothing is in its way.
#[test]
fn rays_end_where_the_material_begins() {
    for shape in shapes() {
        let surface = surface(shape.clone());
        let mut hits = 0;
        for k in 0..400 {
            let x = f64::from(k);
            let origin = Vector3::new((x * 0.7).sin(), (x * 1.1).cos(), (x * 0.37).sin()) * 0.6;
            let aim = Vector3::new((x * 1.9).cos(), (x * 0.3).sin(), (x * 2.3).cos()) * 0.1;
            if surface.distance_and_normal(&origin).0 < 0.05 {
                continue;
            }
            let ray = Ray {
                origin,
                direction: (aim - origin) * 1.3,
            };
            let local = surface.ray_in_surface(&ray);
            // If the distance is only a lower bound, the inside may be taken for the outside.
            if surface.enter(&local, [0.0, 0.0]).is_some() {
                continue;
            }
            let found = surface.enter(&local, [0.0, 3.0]);
            // Whether a point lies inside, tested in small steps along the ray. Far from a height
            // field the distance is only an estimate, so there the point itself is tested.
            let graph = matches!(
                shape,
                ShapeConfig::Sheet { .. } | ShapeConfig::HeightField { .. }
            );
            let clearance = |t: f64| surface.distance_and_normal(&ray.at(t)).0;
            let inside = |t: f64| match graph {
                true => surface.enter(&local, [t, t]).is_some(),
                false => clearance(t) < -2e-5,
            };
            let walked = (0..30_000)
                .map(|i| f64::from(i) * 1e-4)
                .find(|t| inside(*t));
            match (found, walked) {
                (Some(t), Some(w)) => {
                    hits += 1;
                    assert!(clearance(t).abs() < 1e-6, "{shape:?}: {}", clearance(t));
                    // The walk may step over a sliver; the ray must not hit later than the walk.
                    assert!(t < w + 1e-3, "{shape:?}: {t} after {w}");
                }
                (None, Some(w)) => panic!("{shape:?}: missed at {w}, ray {ray:?}"),
                (Some(t), None) => assert!(clearance(t).abs() < 1e-5, "{shape:?}: grazes at {t}"),
                (None, None) => {}
            }
        }
        assert!(hits > 30, "{shape:?}: {hits}");
    }
}

#[test]
fn every_pixel_lies_on_the_surface_or_on_the_table() {
    for shape in shapes() {
        let surface = surface(shape.clone());
        let config = DepthCameraConfig {
            table_height_m: Some(-0.4),
            ..exact()
        };
        let mut camera = DepthCamera::new(&config, &Pose::identity(), 1).unwrap();
        let flange = above(0.5, 0.2, -0.1);
        let frame = camera.picture(0.0, 0, &flange, &surface);
        let mut on_surface = 0;
        for (i, mm) in frame.depth_mm.iter().enumerate() {
            if *mm == 0 {
                continue;
            }
            let [a, b] = frame.intrinsics.ray((i % 160) as f64, (i / 160) as f64);
            let point = flange.transform_point(&(Vector3::new(a, b, 1.0) * f64::from(*mm) * 1e-3));
            let off = surface
                .distance_and_normal(&point)
                .0
                .abs()
                .min((point.z + 0.4).abs());
            // Half a millimetre of rounding along the ray, plus the tolerance of the rendering.
            assert!(off < 1.0e-3, "{shape:?} pixel {i}: {off}");
            on_surface += u32::from(surface.distance_and_normal(&point).0.abs() < 1.0e-3);
        }
        assert!(on_surface > 1000, "{shape:?}: {on_surface}");
    }
}

#[test]
fn a_surface_ends_where_it_was_cut_off() {
    let surface = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
    let extent = [[-0.05, -0.1, -0.02], [0.05, 0.1, 0.5]];
    let config = DepthCameraConfig {
        extent_m: Some(extent),
        ..exact()
    };
    let mut camera = DepthCamera::new(&config, &Pose::identity(), 1).unwrap();
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    let frame = camera.picture(0.0, 0, &Pose::new(Vector3::z() * 0.4, down), &surface);
    // 0.05 m and 0.1 m at 0.4 m are 12.5 and 25 pixels.
    for (i, mm) in frame.depth_mm.iter().enumerate() {
        let (u, v) = ((i % 160) as f64 - 79.5, (i / 160) as f64 - 59.5);
        let inside = u.abs() <= 12.5 && v.abs() <= 25.0;
        assert_eq!(*mm, if inside { 400 } else { 0 }, "{u} {v}");
    }
}

#[test]
fn noise_is_as_large_as_it_says_and_grows_with_the_square_of_the_depth() {
    let surface = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    for far in [0.3, 0.5, 1.0] {
        let noise = DepthNoiseConfig {
            sd_at_half_metre_m: 0.002,
            ..DepthNoiseConfig::none()
        };
        let config = DepthCameraConfig { noise, ..exact() };
        let mut camera = DepthCamera::new(&config, &Pose::identity(), 3).unwrap();
        let frame = camera.picture(0.0, 0, &Pose::new(Vector3::z() * far, down), &surface);
        let n = frame.depth_mm.len() as f64;
        let off = |mm: &u16| f64::from(*mm) * 1e-3 - far;
        let mean = frame.depth_mm.iter().map(off).sum::<f64>() / n;
        let sd = (frame.depth_mm.iter().map(|mm| off(mm).powi(2)).sum::<f64>() / n).sqrt();
        // Rounding to whole millimetres.
        let rounding = 1e-3 / 12.0f64.sqrt();
        let expected = (0.002 * (far / 0.5f64).powi(2)).hypot(rounding);
        assert!(
            (sd / expected - 1.0).abs() < 0.05,
            "{far}: {sd} for {expected}"
        );
        assert!(mean.abs() < 0.1 * expected, "{mean}");
    }
}

#[test]
fn disparity_comes_in_steps() {
    let surface = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
    let noise = DepthNoiseConfig {
        disparity_steps: 4,
        baseline_m: 0.05,
        ..DepthNoiseConfig::none()
    };
    let config = DepthCameraConfig {
        noise,
        range_m: [0.1, 5.0],
        ..exact()
    };
    let mut camera = DepthCamera::new(&config, &Pose::identity(), 3).unwrap();
    let frame = camera.picture(0.0, 0, &above(1.5, 0.5, 0.0), &surface);
    for mm in frame.depth_mm.iter().filter(|mm| **mm > 0) {
        let steps = 4.0 * 100.0 * 0.05 / (f64::from(*mm) * 1e-3);
        let rounding = 0.6e-3 * steps / (f64::from(*mm) * 1e-3);
        assert!((steps - steps.round()).abs() < rounding, "{mm}: {steps}");
    }
}

#[test]
fn holes_edges_and_grazing_cost_pixels() {
    let ball = surface(ShapeConfig::Sphere { radius_m: 0.1 });
    let none = DepthNoiseConfig::none();
    let readings = |noise: DepthNoiseConfig| {
        let config = DepthCameraConfig {
            noise,
            table_height_m: Some(-0.3),
            ..exact()
        };
        let mut camera = DepthCamera::new(&config, &Pose::identity(), 3).unwrap();
        let frame = camera.picture(0.0, 0, &above(0.4, 0.0, 0.0), &ball);
        frame.depth_mm
    };
    let all = readings(none);
    let count = |depth_mm: &[u16]| depth_mm.iter().filter(|mm| **mm > 0).count();
    assert_eq!(count(&all), 160 * 120);
    let lost = count(&readings(DepthNoiseConfig {
        lost_share: 0.1,
        ..none
    }));
    assert!((lost as f64 / (160.0 * 120.0) - 0.9).abs() < 0.02, "{lost}");
    assert!(
        count(&readings(DepthNoiseConfig {
            holes_per_frame: 20.0,
            hole_radius_px: 6.0,
            ..none
        })) < 160 * 120 - 100
    );
    assert!(
        count(&readings(DepthNoiseConfig {
            grazing_from_rad: 0.9,
            grazing_to_rad: 1.2,
            ..none
        })) < 160 * 120 - 100
    );
    // The shadow lies on one side: where the ball hides the background from the right imager, which
    // is to the camera's right.
    let shadow = readings(DepthNoiseConfig {
        stereo_shadow: true,
        ..none
    });
    assert!(count(&shadow) < 160 * 120 - 100);
    // Some pixels at the edge lie between ball and table.
    let flying = readings(DepthNoiseConfig {
        flying_share: 1.0,
        ..none
    });
    let between = all
        .iter()
        .zip(&flying)
        .filter(|(a, b)| a.abs_diff(**b) > 5)
        .count();
    assert!(between > 50, "{between}");
    let extremes = [*all.iter().min().unwrap(), *all.iter().max().unwrap()];
    assert!(
        flying
            .iter()
            .all(|mm| *mm >= extremes[0] && *mm <= extremes[1])
    );
}

#[test]
fn the_tool_hides_what_is_behind_it() {
    let surface = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
    let config = DepthCameraConfig {
        tool: Some(ToolInViewConfig {
            radius_m: 0.02,
            length_m: 0.1,
        }),
        flange_from_camera: PoseConfig {
            position_m: [0.0, -0.08, 0.0],
            roll_pitch_yaw_rad: [0.0; 3],
        },
        ..exact()
    };
    let tool = Pose::new(Vector3::new(0.0, 0.0, 0.3), UnitQuaternion::identity());
    let mut camera = DepthCamera::new(&config, &tool, 3).unwrap();
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    let frame = camera.picture(0.0, 0, &Pose::new(Vector3::z() * 0.4, down), &surface);
    let at = |y_m: f64, z: f64| {
        let v = frame.intrinsics.cy_px + 100.0 * y_m / z;
        frame.depth_mm[v.round() as usize * 160 + 80]
    };
    // The ray to the middle of the rod's end hits its side first, 0.06 m from the axis.
    let side = at(0.08, 0.3);
    assert!((220..=230).contains(&side), "{side}");
    let side = at(0.06, 0.25);
    assert!((245..=255).contains(&side), "{side}");
    // The ray beside the rod hits the surface.
    assert_eq!(at(0.0, 0.3), 400);
}

#[test]
fn frames_come_at_their_rate_late_by_the_delay_and_the_same_every_time() {
    let surface = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
    let config = DepthCameraConfig {
        rate_hz: 30.0,
        noise: DepthNoiseConfig::default(),
        ..exact()
    };
    let run = |seed: u64| {
        let mut camera = DepthCamera::new(&config, &Pose::identity(), seed).unwrap();
        let mut arrived = Vec::new();
        for k in 0..1000 {
            let time_s = f64::from(k) * 1e-3;
            camera.expose(time_s, &above(0.4, 0.1, 0.0), &surface);
            while let Some(frame) = camera.take(time_s) {
                let late = time_s - frame.time_s;
                assert!((0.029..0.062).contains(&late), "{late}");
                arrived.push(frame);
            }
        }
        arrived
    };
    let frames = run(1);
    // 30 frames were exposed in one second; the last one or two are still in transit.
    assert!((28..=29).contains(&frames.len()), "{}", frames.len());
    assert!(
        frames
            .windows(2)
            .all(|w| w[1].sequence == w[0].sequence + 1)
    );
    assert!(
        frames
            .windows(2)
            .all(|w| (w[1].time_s - w[0].time_s - 1.0 / 30.0).abs() < 1.1e-3)
    );
    assert_eq!(frames, run(1));
    assert_ne!(frames, run(2));
    assert_ne!(frames[0].depth_mm, frames[1].depth_mm);
}

#[test]
fn a_region_and_a_coarser_image_see_the_same() {
    let surface = surface(ShapeConfig::Cylinder { radius_m: 0.12 });
    let flange = above(0.4, 0.1, 0.1);
    let whole = DepthCamera::new(&exact(), &Pose::identity(), 1)
        .unwrap()
        .picture(0.0, 0, &flange, &surface);
    let part = DepthCameraConfig {
        region_px: Some([40, 30, 60, 50]),
        decimation: 2,
        ..exact()
    };
    let frame = DepthCamera::new(&part, &Pose::identity(), 1)
        .unwrap()
        .picture(0.0, 0, &flange, &surface);
    assert_eq!((frame.width, frame.height), (30, 25));
    for v in 0..25 {
        for u in 0..30 {
            let there = whole.depth_mm[(30 + 2 * v) * 160 + 40 + 2 * u];
            let here = frame.depth_mm[v * 30 + u];
            assert!(there.abs_diff(here) <= 1, "{u} {v}: {here} for {there}");
        }
    }
}

#[test]
fn settings_that_no_camera_has_are_named() {
    let refused = |config: DepthCameraConfig| config.check().unwrap_err().to_string();
    let base = DepthCameraConfig::default;
    assert_eq!(
        refused(DepthCameraConfig {
            focal_px: 0.0,
            ..base()
        }),
        "depth_camera: focal_px = 0 is out of range: 1 to 10000 is allowed"
    );
    assert!(
        refused(DepthCameraConfig {
            delay_s: [0.06, 0.03],
            ..base()
        })
        .contains("delay_s[1] = 0.03")
    );
    assert!(
        refused(DepthCameraConfig {
            region_px: Some([600, 0, 100, 10]),
            ..base()
        })
        .contains("does not lie in the image")
    );
    assert!(
        refused(DepthCameraConfig {
            extent_m: Some([[0.0; 3], [1.0, 0.0, 1.0]]),
            ..base()
        })
        .contains("axis 1")
    );
    let unknown: Result<DepthCameraConfig, _> = toml::from_str("focal = 3.0");
    assert!(unknown.unwrap_err().to_string().contains("focal"));
}
