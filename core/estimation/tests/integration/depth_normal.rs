//! Tests `depth_normal` on exact scenes and on arbitrary depth images.

// A whole file of tests: what fails here is the test.
use nalgebra::{Matrix3, Rotation3, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use tangent_estimation::depth_normal::{
    DepthImage, DepthNormal, DepthNormalConfig, DepthNormalPaper, DepthNormalPaperConfig,
    DepthNormalState, DepthSample, Intrinsics, ToolTarget, VisualNormal, VisualValidity,
};

const INTRINSICS: Intrinsics = Intrinsics {
    fx_px: 190.0,
    fy_px: 195.0,
    cx_px: 158.0,
    cy_px: 121.0,
};
const SIZE: [usize; 2] = [320, 240];

/// Depth of every pixel; `depth` takes a ray.
fn render(size: [usize; 2], depth: impl Fn([f64; 2]) -> Option<f64>) -> Vec<f32> {
    (0..size[0] * size[1])
        .map(|i| {
            let ray = INTRINSICS.ray((i % size[0]) as f64, (i / size[0]) as f64);
            depth(ray).map_or(0.0, |z| z as f32)
        })
        .collect()
}

fn plane(normal: Vector3<f64>, distance: f64) -> impl Fn([f64; 2]) -> Option<f64> {
    move |[a, b]| {
        let z = distance / normal.dot(&Vector3::new(a, b, 1.0));
        (z > 0.0).then_some(z)
    }
}

fn sphere(centre: Vector3<f64>, radius: f64) -> impl Fn([f64; 2]) -> Option<f64> {
    move |[a, b]| {
        let ray = Vector3::new(a, b, 1.0);
        let (square, dot) = (ray.norm_squared(), ray.dot(&centre));
        let rest = dot * dot - square * (centre.norm_squared() - radius * radius);
        (rest >= 0.0).then(|| (dot - rest.sqrt()) / square)
    }
}

fn noisy(depth_m: &[f32], inverse_sd: f64, seed: u64) -> Vec<f32> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    depth_m
        .iter()
        .map(|z| {
            let x: f64 = StandardNormal.sample(&mut rng);
            let w = 1.0 / f64::from(*z) + inverse_sd * x;
            if *z > 0.0 && w > 0.0 {
                (1.0 / w) as f32
            } else {
                0.0
            }
        })
        .collect()
}

fn sample<'a>(size: [usize; 2], depth_m: &'a [f32], target: [f64; 2]) -> DepthSample<'a> {
    DepthSample {
        time_s: 1.5,
        image: DepthImage::new(size[0], size[1], depth_m).unwrap(),
        intrinsics: INTRINSICS,
        target: ToolTarget::Pixel(target),
        left_out: None,
        travel: Some(Vector3::x()),
    }
}

fn look(size: [usize; 2], depth_m: &[f32], target: [f64; 2]) -> (VisualNormal, Vec<[f32; 3]>) {
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    let mut state = DepthNormalState::default();
    let sample = sample(size, depth_m, target);
    let found = step.update(&mut state, &sample);
    let mut normals = vec![[9.0; 3]; depth_m.len()];
    assert!(step.normals(&state, &sample.image, &mut normals));
    (found, normals)
}

/// Checks that all numbers are finite, that normals have unit length, and that pixels without depth
/// have none.
fn sound(found: &VisualNormal, depth_m: &[f32], normals: &[[f32; 3]]) {
    assert!((found.normal.norm() - 1.0).abs() < 1e-9);
    assert!(found.point.iter().all(|x| x.is_finite()));
    assert!(
        found
            .covariance
            .iter()
            .chain(found.curvature.iter())
            .all(|x| x.is_finite())
    );
    assert!(found.tilt_rad.is_finite() && !found.validity.reason().is_empty());
    if found.validity.is_valid() {
        assert!(found.normal.dot(&found.point) < 0.0, "faces the camera");
        assert!(found.covariance.symmetric_eigenvalues().min() > -1e-12);
    }
    for station in &found.ahead.stations {
        assert!((station.normal.norm() - 1.0).abs() < 1e-9 && station.bend_per_m.is_finite());
    }
    for (normal, z) in normals.iter().zip(depth_m) {
        let length = normal.iter().map(|x| x * x).sum::<f32>();
        assert!(
            (length - 1.0).abs() < 1e-4 || *normal == [0.0; 3],
            "{normal:?}"
        );
        if !(*z >= 0.05 && *z <= 4.0) {
            assert_eq!(*normal, [0.0; 3]);
        }
    }
}

#[test]
fn a_plane_is_found_exactly_at_every_pixel() {
    for turn in [[0.0, 0.0], [0.4, -0.3], [-0.7, 0.2]] {
        let normal = Rotation3::from_euler_angles(turn[0], turn[1], 0.0) * Vector3::z();
        let depth_m = render(SIZE, plane(normal, 0.4));
        let (found, normals) = look(SIZE, &depth_m, [150.0, 100.0]);
        sound(&found, &depth_m, &normals);
        assert_eq!(found.validity, VisualValidity::Valid);
        assert!((found.normal + normal).norm() < 1e-5, "{}", found.normal);
        assert!((normal.dot(&found.point) - 0.4).abs() < 1e-6);
        assert!(found.curvature.amax() < 2e-2, "{}", found.curvature);
        let worst = normals
            .iter()
            .map(|n| (Vector3::from(n.map(f64::from)) + normal).norm())
            .fold(0.0, f64::max);
        assert!(worst < 2e-4, "{worst}");
        // Eqs. (15) and (16).
        assert!((found.tilt_rad - normal.z.acos()).abs() < 1e-5);
        let segment = found.segment.unwrap();
        assert!(segment.variation < 1e-6 && (segment.normal + normal).norm() < 1e-4);
        assert_eq!(found.segments, 1);
    }
}

#[test]
fn a_sphere_has_its_normal_curvature_and_point() {
    let centre = Vector3::new(0.01, -0.02, 0.5);
    // Cells are 17 mm wide at this resolution, which limits the accuracy to a tenth of the radius.
    for (radius, off_max) in [(0.1, 0.02), (0.2, 0.01)] {
        let depth_m = render(SIZE, sphere(centre, radius));
        for target in [[158.0, 110.0], [170.0, 121.0], [150.0, 100.0]] {
            let (found, normals) = look(SIZE, &depth_m, target);
            sound(&found, &depth_m, &normals);
            assert_eq!(found.validity, VisualValidity::Valid);
            let normal = (found.point - centre).normalize();
            assert!(
                (found.normal - normal).norm() < off_max,
                "{}",
                (found.normal - normal).norm()
            );
            assert!(((found.point - centre).norm() - radius).abs() < 5e-4);
            for k in found.principal_curvatures_per_m {
                assert!((k * radius - 1.0).abs() < 0.1, "{k} of {}", 1.0 / radius);
            }
            let expected = (Matrix3::identity() - normal * normal.transpose()) / radius;
            assert!((found.curvature - expected).norm() * radius < 0.15);
        }
    }
}

#[test]
fn noise_found_in_the_image_is_the_noise_that_was_put_in() {
    let clean = render(SIZE, sphere(Vector3::new(0.0, 0.0, 0.55), 0.2));
    for sd in [0.002, 0.006, 0.02] {
        let (found, _) = look(SIZE, &noisy(&clean, sd, 3), [158.0, 121.0]);
        let ratio = found.noise.scale / (sd / 0.006f64).powi(2);
        assert!((ratio - 1.0).abs() < 0.15, "{sd}: {ratio}");
        // Cells are wide here, so the sphere's own curvature contributes a little.
        assert!(found.noise.correlation < 2.0, "{:?}", found.noise);
    }
}

#[test]
fn a_step_is_not_smeared_over() {
    // Two planes of one orientation, one 5 cm in front of the other.
    let normal = Rotation3::from_euler_angles(0.3, 0.0, 0.0) * Vector3::z();
    let (near, far) = (plane(normal, 0.40), plane(normal, 0.45));
    let depth_m = render(SIZE, |ray| if ray[0] < 0.02 { near(ray) } else { far(ray) });
    let depth_m = noisy(&depth_m, 0.004, 11);
    let (found, normals) = look(SIZE, &depth_m, [100.0, 120.0]);
    assert_eq!(found.validity, VisualValidity::Valid);
    assert_eq!(found.segments, 2);
    let off = |n: &[f32; 3]| {
        (Vector3::from(n.map(f64::from)) + normal)
            .norm()
            .to_degrees()
    };
    let worst = normals.iter().map(off).fold(0.0, f64::max);
    assert!(worst < 8.0, "{worst}");
    // Every pixel has a normal, including those at the step.
    assert!(normals.iter().all(|n| *n != [0.0; 3]));
    // Close to the step, the surface is visible on only one side of the tool, and its position is
    // right.
    let (found, _) = look(SIZE, &depth_m, [150.0, 120.0]);
    assert!(
        (normal.dot(&found.point) - 0.40).abs() < 3e-3,
        "{}",
        normal.dot(&found.point)
    );
}

#[test]
fn a_crease_parts_segments() {
    let (left, right) = (
        Rotation3::from_euler_angles(0.0, 0.5, 0.0),
        Rotation3::from_euler_angles(0.0, -0.5, 0.0),
    );
    let (p, q) = (
        plane(left * Vector3::z(), 0.4),
        plane(right * Vector3::z(), 0.4),
    );
    let depth_m = render(SIZE, |s| Some(p(s).unwrap_or(9.0).min(q(s).unwrap_or(9.0))));
    let depth_m = noisy(&depth_m, 0.004, 5);
    let (found, _) = look(SIZE, &depth_m, [60.0, 120.0]);
    assert_eq!(found.validity, VisualValidity::Valid);
    let normals = [left, right].map(|r| -(r * Vector3::z()));
    let off = normals.map(|n| found.normal.cross(&n).norm());
    assert!(off[0].min(off[1]) < 0.02, "{off:?}");
    let segment = found.segment.unwrap();
    let off = normals.map(|n| segment.normal.cross(&n).norm());
    assert!(off[0].min(off[1]) < 0.02, "{off:?}");
}

#[test]
fn mirrored_data_gives_the_mirrored_normal() {
    let centre = Vector3::new(0.05, 0.02, 0.5);
    let symmetric = Intrinsics {
        cx_px: (SIZE[0] as f64 - 1.0) / 2.0,
        ..INTRINSICS
    };
    let depth_m: Vec<f32> = (0..SIZE[0] * SIZE[1])
        .map(|i| {
            let ray = symmetric.ray((i % SIZE[0]) as f64, (i / SIZE[0]) as f64);
            sphere(centre, 0.15)(ray).map_or(0.0, |z| z as f32)
        })
        .collect();
    let depth_m = noisy(&depth_m, 0.004, 4);
    let mirrored: Vec<f32> = depth_m
        .chunks(SIZE[0])
        .flat_map(|row| row.iter().rev().copied())
        .collect();
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    let of = |depth_m: &[f32], u: f64| {
        let sample = DepthSample {
            intrinsics: symmetric,
            travel: None,
            ..sample(SIZE, depth_m, [u, 125.0])
        };
        step.update(&mut DepthNormalState::default(), &sample)
    };
    let (one, other) = (
        of(&depth_m, 180.0),
        of(&mirrored, SIZE[0] as f64 - 1.0 - 180.0),
    );
    assert_eq!(one.validity, VisualValidity::Valid);
    let flip = Vector3::new(-1.0, 1.0, 1.0);
    // Not equal to the last bit: the noise is measured on every other cell, and these differ in the
    // mirror image.
    assert!((one.normal.component_mul(&flip) - other.normal).norm() < 1e-3);
    assert!((one.point.component_mul(&flip) - other.point).norm() < 1e-4);
}

#[test]
fn the_tool_is_left_out_and_the_surface_goes_on_behind_it() {
    let normal = Rotation3::from_euler_angles(0.2, 0.2, 0.0) * Vector3::z();
    let mut depth_m = noisy(&render(SIZE, plane(normal, 0.35)), 0.004, 8);
    let mut mask = vec![0; depth_m.len()];
    for (i, z) in depth_m.iter_mut().enumerate() {
        let (u, v) = ((i % SIZE[0]) as f64, (i / SIZE[0]) as f64);
        if (u - 160.0).abs() < 9.0 && v < 130.0 {
            *z = 0.2;
        }
        mask[i] = u8::from((u - 160.0).abs() < 12.0 && v < 133.0);
    }
    let sample = DepthSample {
        left_out: Some(&mask),
        ..sample(SIZE, &depth_m, [160.0, 128.0])
    };
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    let found = step.update(&mut DepthNormalState::default(), &sample);
    assert_eq!(found.validity, VisualValidity::Valid);
    assert!(
        (found.normal + normal).norm() < 0.02,
        "{}",
        (found.normal + normal).norm()
    );
    assert!((normal.dot(&found.point) - 0.35).abs() < 1e-3);
}

#[test]
fn what_cannot_be_said_has_its_reason() {
    let flat = render(SIZE, plane(Vector3::z(), 0.4));
    let (found, _) = look(SIZE, &flat, [400.0, 10.0]);
    assert_eq!(found.validity, VisualValidity::OutOfImage);
    let (found, _) = look(SIZE, &flat, [f64::NAN, 10.0]);
    assert_eq!(found.validity, VisualValidity::BadInput);
    // At the corner of the image, the surface is on one side only.
    let (found, _) = look(SIZE, &flat, [0.0, 0.0]);
    assert_eq!(found.validity, VisualValidity::Edge);
    for nothing in [0.0, f32::NAN, -1.0, f32::INFINITY, 50.0, 0.001] {
        let depth_m = vec![nothing; SIZE[0] * SIZE[1]];
        let (found, normals) = look(SIZE, &depth_m, [100.0, 100.0]);
        assert_eq!(found.validity, VisualValidity::NoDepth, "{nothing}");
        sound(&found, &depth_m, &normals);
        assert!(found.segment.is_none() && found.ahead.stations.is_empty());
    }
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    let mut state = DepthNormalState::default();
    let short = [0u8; 7];
    let bad = [
        DepthSample {
            intrinsics: Intrinsics {
                fx_px: 0.0,
                ..INTRINSICS
            },
            ..sample(SIZE, &flat, [9.0; 2])
        },
        DepthSample {
            intrinsics: Intrinsics {
                cy_px: f64::NAN,
                ..INTRINSICS
            },
            ..sample(SIZE, &flat, [9.0; 2])
        },
        DepthSample {
            left_out: Some(&short),
            ..sample(SIZE, &flat, [9.0; 2])
        },
        DepthSample {
            target: ToolTarget::Point(-Vector3::z()),
            ..sample(SIZE, &flat, [9.0; 2])
        },
    ];
    for sample in bad {
        assert_eq!(
            step.update(&mut state, &sample).validity,
            VisualValidity::BadInput
        );
    }
    assert!(DepthImage::new(3, 3, &[0.0; 8]).is_none());
    assert!(DepthImage::new(0, 0, &[]).is_none());
    // A surface seen nearly edge-on does not count as a surface.
    let steep = render(
        SIZE,
        plane(
            Rotation3::from_euler_angles(1.5, 0.0, 0.0) * Vector3::z(),
            0.05,
        ),
    );
    let (found, normals) = look(SIZE, &steep, [158.0, 121.0]);
    assert!(!found.validity.is_valid());
    sound(&found, &steep, &normals);
}

#[test]
fn any_size_will_do() {
    for size in [[1, 1], [1, 9], [7, 1], [8, 8], [9, 17], [33, 5], [100, 75]] {
        let depth_m = render(size, plane(Vector3::z(), 0.5));
        let (found, normals) = look(size, &depth_m, [0.0, 0.0]);
        sound(&found, &depth_m, &normals);
        if size[0] * size[1] >= 64 && size[0].min(size[1]) > 1 {
            assert!(normals.iter().all(|n| *n != [0.0; 3]), "{size:?}");
        }
    }
}

#[test]
fn a_state_that_has_seen_other_frames_says_the_same_and_allocates_nothing() {
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    let frames = [0.0, 0.1, 0.2].map(|x| {
        noisy(
            &render(SIZE, sphere(Vector3::new(x, 0.0, 0.5), 0.15)),
            0.005,
            2,
        )
    });
    let mut state = DepthNormalState::default();
    let mut normals = vec![[0.0; 3]; SIZE[0] * SIZE[1]];
    step.update(&mut state, &sample(SIZE, &frames[0], [158.0, 121.0]));
    for depth_m in &frames {
        let sample = sample(SIZE, depth_m, [170.0, 121.0]);
        let mut found = None;
        let info = allocation_counter::measure(|| {
            found = Some(step.update(&mut state, &sample));
            step.normals(&state, &sample.image, &mut normals);
        });
        assert_eq!(info.count_total, 0);
        let fresh = step.update(&mut DepthNormalState::default(), &sample);
        assert_eq!(format!("{:?}", found.unwrap()), format!("{fresh:?}"));
    }
    // Another size, and back to the first.
    let small = render([64, 48], plane(Vector3::z(), 0.5));
    step.update(&mut state, &sample([64, 48], &small, [30.0, 20.0]));
    assert!(!step.normals(
        &state,
        &DepthImage::new(SIZE[0], SIZE[1], &frames[0]).unwrap(),
        &mut normals
    ));
    let sample = sample(SIZE, &frames[1], [170.0, 121.0]);
    let again = step.update(&mut state, &sample);
    let fresh = step.update(&mut DepthNormalState::default(), &sample);
    assert_eq!(format!("{again:?}"), format!("{fresh:?}"));
}

#[test]
fn settings_out_of_range_are_named() {
    let refused = |config: DepthNormalConfig| DepthNormal::new(&config).unwrap_err().to_string();
    let default = DepthNormalConfig::default;
    assert!(
        refused(DepthNormalConfig {
            cell_px: 0,
            ..default()
        })
        .contains("depth_normal.cell_px = 0")
    );
    assert!(
        refused(DepthNormalConfig {
            range_m: [0.5, 0.2],
            ..default()
        })
        .contains("range_m[1] = 0.2")
    );
    assert!(
        refused(DepthNormalConfig {
            consistency_sd: f64::NAN,
            ..default()
        })
        .contains("consistency_sd = NaN")
    );
    let unknown: Result<DepthNormalConfig, _> = toml::from_str("cell = 3");
    assert!(unknown.unwrap_err().to_string().contains("cell"));
}

#[test]
fn the_papers_way_agrees_on_a_plane_and_measures_its_curvature() {
    let step = DepthNormalPaper::new(&DepthNormalPaperConfig::default()).unwrap();
    let normal = Rotation3::from_euler_angles(0.2, -0.3, 0.0) * Vector3::z();
    let depth_m = noisy(&render(SIZE, plane(normal, 0.4)), 0.004, 6);
    let flat = step.update(&sample(SIZE, &depth_m, [158.0, 121.0]));
    assert_eq!(flat.validity, VisualValidity::Valid);
    let segment = flat.segment.unwrap();
    assert!(
        (segment.normal + normal).norm() < 0.01,
        "{:?}",
        segment.normal
    );
    assert!((flat.tilt_rad - normal.z.acos()).abs() < 0.01);
    // The variation, eq. (16), grows with curvature.
    let mut before = segment.variation;
    for radius in [0.4, 0.2, 0.1] {
        let depth_m = noisy(
            &render(SIZE, sphere(Vector3::new(0.0, 0.0, 0.35 + radius), radius)),
            0.004,
            6,
        );
        let bent = step.update(&sample(SIZE, &depth_m, [158.0, 121.0]));
        let variation = bent.segment.unwrap().variation;
        assert!(variation > before, "{radius}: {variation} after {before}");
        before = variation;
    }
    let nothing = vec![0.0; SIZE[0] * SIZE[1]];
    assert_eq!(
        step.update(&sample(SIZE, &nothing, [9.0; 2])).validity,
        VisualValidity::NoDepth
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// For planes, spheres, noise and holes mixed by blocks, nothing panics and all results are
    /// finite.
    #[test]
    fn any_image_gives_a_sound_answer(seed in 0u64..1_000_000, width in 1usize..90, height in 1usize..70, target in [-5.0f64..95.0, -5.0..75.0]) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let block = rng.random_range(1..12);
        let kinds: Vec<u8> = (0..100 * 100).map(|_| rng.random_range(0..7)).collect();
        let ball = sphere(Vector3::new(-0.2, -0.1, 0.5), 0.2);
        let depth_m: Vec<f32> = (0..width * height)
            .map(|i| {
                let (u, v) = (i % width, i / width);
                let ray = INTRINSICS.ray(u as f64, v as f64);
                match kinds[v / block * 100 + u / block] {
                    0 => f32::NAN,
                    1 => f32::from_bits(rng.random()),
                    2 => 0.0,
                    3 => 0.3 + rng.random::<f32>() * 0.5,
                    4 => ball(ray).unwrap_or(0.8) as f32,
                    _ => 0.6,
                }
            })
            .collect();
        let (found, normals) = look([width, height], &depth_m, target);
        sound(&found, &depth_m, &normals);
        let paper = DepthNormalPaper::new(&DepthNormalPaperConfig::default()).unwrap();
        let said = paper.update(&sample([width, height], &depth_m, target));
        prop_assert!(said.covariance.iter().all(|x| x.is_finite()) && said.tilt_rad.is_finite());
    }
}

#[test]
fn the_covariance_is_honest_where_the_noise_is_white() {
    let turned = Rotation3::from_euler_angles(0.3, -0.2, 0.0) * Vector3::z();
    let centre = Vector3::new(0.0, 0.0, 0.6);
    let flat = render(SIZE, plane(turned, 0.35));
    let round = render(SIZE, sphere(centre, 0.25));
    for (name, clean) in [("plane", flat), ("sphere", round)] {
        let (mut sum, mut bends) = (0.0, 0.0);
        let runs = 100;
        for seed in 0..runs {
            let k = seed as f64;
            let target = [
                150.0 + 30.0 * (k * 0.9).sin(),
                120.0 + 25.0 * (k * 1.7).cos(),
            ];
            let (found, _) = look(SIZE, &noisy(&clean, 0.006, 1000 + seed), target);
            assert_eq!(found.validity, VisualValidity::Valid);
            let truth = if name == "plane" {
                -turned
            } else {
                (found.point - centre).normalize()
            };
            let x = found.normal.cross(&Vector3::x()).normalize();
            let axes = [x, found.normal.cross(&x)];
            let e = nalgebra::Vector2::new(axes[0].dot(&truth), axes[1].dot(&truth));
            let p = nalgebra::Matrix2::from_fn(|i, j| axes[i].dot(&(found.covariance * axes[j])));
            sum += e.dot(&(p.try_inverse().unwrap() * e)) / 2.0;
            let bend = if name == "plane" { 0.0 } else { 4.0 };
            let station = found.ahead.stations[0];
            bends += ((station.bend_per_m - bend) / station.bend_sd_per_m).powi(2);
        }
        let (nees, bends) = (sum / runs as f64, bends / runs as f64);
        // The mean for a consistent covariance is 1 +- 0.1 (one sigma). The covariance allows for a
        // change of curvature that these surfaces do not have.
        assert!(
            nees > 0.6 && nees < 1.4,
            "{name}: normal {nees}, bend {bends}"
        );
        assert!(bends < 1.6, "{name}: normal {nees}, bend {bends}");
    }
}
