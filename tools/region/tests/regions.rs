//! Regions of meshes whose exact answers are known.

#![allow(clippy::unwrap_used)]

use nalgebra::{Rotation3, Vector2, Vector3};
use tangent_control::{Pattern, Task};
use tangent_mechanics::{ModelData, Pose, Tip};

use tangent_region::{Draft, Mesh, RegionError, RegionOptions, Selection, draft};

/// A mesh of `z = height(x, y)` over `size` (m) with nodes `step` apart.
fn graph(size: [f64; 2], step: f64, height: impl Fn(f64, f64) -> f64) -> Mesh {
    let [columns, rows] = size.map(|s| (s / step).round() as u32 + 1);
    let mut mesh = Mesh::default();
    for k in 0..columns * rows {
        let (x, y) = (f64::from(k % columns) * step, f64::from(k / columns) * step);
        mesh.vertices.push(Vector3::new(x, y, height(x, y)));
    }
    for j in 0..rows - 1 {
        for i in 0..columns - 1 {
            let k = j * columns + i;
            mesh.triangles.push([k, k + 1, k + columns + 1]);
            mesh.triangles.push([k, k + columns + 1, k + columns]);
        }
    }
    mesh
}

fn options<'a>() -> RegionOptions<'a> {
    RegionOptions {
        name: "part",
        source: "part.stl",
        selection: Selection::All,
        approach: Some([0.0, 0.0, -1.0]),
        rows_along: [1.0, 0.0, 0.0],
        outline_m: None,
        holes_m: Vec::new(),
        pattern: Pattern::Raster,
        edge_pass: false,
        edge_force_n: None,
        edge_speed_m_per_s: None,
        radius_m: 0.01,
        spacing_m: Some(0.008),
        margin_m: Some(0.01),
        touch_m: None,
        force_n: 5.0,
        speed_m_per_s: 0.03,
        dose_n_s_per_cm2: None,
        clearance_m: 0.03,
        arm: None,
    }
}

/// Strokes in the base, on the surface `height`.
fn strokes(draft: &Draft, height: impl Fn(f64, f64) -> f64) -> Vec<Vec<Vector3<f64>>> {
    let tangent_control::PathSpec::Strokes(path) = &draft.task.path else {
        panic!("no strokes");
    };
    let place = |p: &[f64; 2]| {
        let flat = draft.plane.in_base(&Vector3::new(p[0], p[1], 0.0));
        Vector3::new(flat.x, flat.y, height(flat.x, flat.y))
    };
    (path.strokes.iter())
        .map(|s| s.points_m.iter().map(place).collect())
        .collect()
}

/// Distance of a place from the nearest of some lines, m.
fn away_m(lines: &[Vec<Vector3<f64>>], at: &Vector3<f64>) -> f64 {
    (lines.iter().flat_map(|line| line.windows(2)))
        .map(|ends| {
            let way = ends[1] - ends[0];
            let share = (at - ends[0]).dot(&way) / way.norm_squared();
            (ends[0] + way * share.clamp(0.0, 1.0) - at).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

/// Rows across a slope of 60 degrees are as far apart on it as was asked for,
/// and not twice as far.
#[test]
fn rows_on_a_slope_of_60_degrees_are_the_spacing_apart_along_the_slope() {
    let rise = 60f64.to_radians().tan();
    for pattern in [Pattern::Raster, Pattern::Contour, Pattern::Spiral] {
        let height = |_: f64, y: f64| rise * y;
        let mesh = graph([0.1, 0.06], 0.005, height);
        let how = RegionOptions {
            pattern,
            ..options()
        };
        let draft = draft(&mesh, &how).unwrap();
        assert!(
            (draft.steepest_deg - 60.0).abs() < 0.5,
            "{}",
            draft.steepest_deg
        );
        assert!(
            (draft.area_cm2 / 120.0 - 1.0).abs() < 0.05,
            "{}",
            draft.area_cm2
        );
        let strokes = strokes(&draft, height);
        if pattern == Pattern::Raster {
            // 120 mm of slope less two margins: 100 mm in 13 gaps.
            let mut heights: Vec<f64> = strokes.iter().map(|s| s[0].y).collect();
            heights.sort_by(f64::total_cmp);
            assert_eq!(heights.len(), 14);
            for rows in heights.windows(2) {
                let gap_m = (rows[1] - rows[0]) * 2.0;
                assert!((0.0072..=0.00805).contains(&gap_m), "{gap_m}");
            }
            // The margin is one along the slope, too.
            assert!((2.0 * heights[0] - 0.01).abs() < 0.001, "{}", heights[0]);
        }
        // No place between the margins is further from a stroke than half the spacing.
        let mut furthest = 0.0_f64;
        for i in 0..=40 {
            for j in 0..=100 {
                let (x, s) = (0.01 + 0.002 * f64::from(i), 0.01 + 0.001 * f64::from(j));
                let y = 0.5 * s;
                let at = Vector3::new(x, y, height(x, y));
                furthest = furthest.max(away_m(&strokes, &at));
            }
        }
        println!(
            "{pattern:?}: {} strokes, furthest {furthest:.5} m",
            strokes.len()
        );
        let most = if pattern == Pattern::Raster {
            0.0042
        } else {
            0.0065
        };
        assert!(furthest < most, "{pattern:?}: {furthest}");
    }
}

/// Steps to the next ring: contours on a sphere are spaced along the sphere.
#[test]
fn rings_on_a_dome_are_the_spacing_apart_along_it() {
    let radius = 0.08_f64;
    let height = |x: f64, y: f64| {
        let (x, y) = (x - 0.065, y - 0.065);
        (radius * radius - (x * x + y * y).min(0.0041)).sqrt()
    };
    let mesh = graph([0.13, 0.13], 0.0025, height);
    let ring: Vec<[f64; 3]> = (0..72)
        .map(|k| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 72.0).sin_cos();
            [0.065 + 0.06 * cos, 0.065 + 0.06 * sin, 0.0]
        })
        .collect();
    let how = RegionOptions {
        pattern: Pattern::Contour,
        outline_m: Some(ring),
        margin_m: Some(0.004),
        ..options()
    };
    let draft = draft(&mesh, &how).unwrap();
    let mut arcs: Vec<f64> = strokes(&draft, height)
        .iter()
        .map(|ring| {
            let mean = ring
                .iter()
                .map(|p| (p.x - 0.065).hypot(p.y - 0.065))
                .sum::<f64>();
            radius * (mean / ring.len() as f64 / radius).asin()
        })
        .collect();
    arcs.sort_by(f64::total_cmp);
    println!("{arcs:?}");
    // The edge is 0.0679 m from the top along the dome.
    for (k, arc) in arcs.iter().rev().enumerate() {
        let wanted = 0.0679 - 0.004 - 0.008 * k as f64;
        let most = 0.0006 + 0.03 * 0.008 * k as f64;
        assert!(
            (arc - wanted).abs() < most || wanted < 0.008,
            "{k}: {arc} {wanted}"
        );
    }
    assert!((7..=10).contains(&arcs.len()), "{}", arcs.len());
}

#[test]
fn a_hole_of_the_mesh_is_kept_clear_and_rows_end_before_it() {
    let mut mesh = graph([0.1, 0.1], 0.005, |_, _| 0.0);
    let vertices = mesh.vertices.clone();
    mesh.triangles.retain(|t| {
        let m = t
            .iter()
            .map(|i| vertices[*i as usize])
            .sum::<Vector3<f64>>()
            / 3.0;
        !((0.04..0.06).contains(&m.x) && (0.04..0.06).contains(&m.y))
    });
    let how = RegionOptions {
        margin_m: Some(0.005),
        dose_n_s_per_cm2: Some([0.8, 8.0]),
        ..options()
    };
    let draft = draft(&mesh, &how).unwrap();
    assert_eq!(draft.rings_m.len(), 2);
    for line in strokes(&draft, |_, _| 0.0) {
        for ends in line.windows(2) {
            for k in 0..=20 {
                let p = ends[0].lerp(&ends[1], f64::from(k) / 20.0);
                let inside = (0.0352..0.0648).contains(&p.x) && (0.0352..0.0648).contains(&p.y);
                let corner = (p.xy() - Vector2::repeat(0.05)).abs() - Vector2::repeat(0.01);
                assert!(
                    !inside || corner.sup(&Vector2::zeros()).norm() > 0.0045,
                    "{p}"
                );
            }
        }
    }
}

#[test]
fn a_box_gives_the_side_that_is_asked_for() {
    let mesh = block();
    // All of it faces nowhere.
    let how = RegionOptions {
        approach: None,
        ..options()
    };
    let error = draft(&mesh, &how).unwrap_err().to_string();
    assert!(error.contains("--approach"), "{error}");
    let turn = std::f64::consts::FRAC_PI_4;
    for (selection, normal) in [
        (
            Selection::Seed {
                at_m: [0.05, 0.04, 0.11],
                angle_rad: 0.3,
            },
            Vector3::z(),
        ),
        (
            Selection::Facing {
                direction: [1.0, 0.0, 0.0],
                angle_rad: turn,
            },
            Vector3::x(),
        ),
    ] {
        let how = RegionOptions {
            selection,
            approach: None,
            rows_along: [0.0, 1.0, 0.0],
            ..options()
        };
        let draft = draft(&mesh, &how).unwrap();
        assert!((draft.plane.normal - normal).norm() < 1e-9);
        assert!(draft.steepest_deg < 0.1);
        assert!(draft.text.parse::<Task>().is_ok());
    }
}

/// 100 mm by 80 mm by 100 mm, as STL files have it: no common vertices.
fn block() -> Mesh {
    let size = Vector3::new(0.1, 0.08, 0.1);
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            let corner = |u: f64, v: f64| {
                let mut p = Vector3::zeros();
                p[axis] = side;
                p[(axis + 1) % 3] = u;
                p[(axis + 2) % 3] = v;
                p.component_mul(&size)
            };
            let ring = [
                corner(0.0, 0.0),
                corner(1.0, 0.0),
                corner(1.0, 1.0),
                corner(0.0, 1.0),
            ];
            for mut t in [[0, 1, 2], [0, 2, 3]] {
                if side == 0.0 {
                    t.reverse();
                }
                let first = vertices.len() as u32;
                vertices.extend(t.map(|k| ring[k]));
                triangles.push([first, first + 1, first + 2]);
            }
        }
    }
    Mesh::new(vertices, triangles).unwrap()
}

#[test]
fn what_cannot_be_pressed_is_refused_with_its_place() {
    let steep = graph([0.1, 0.06], 0.005, |_, y| 4.0 * y);
    let error = draft(&steep, &options()).unwrap_err();
    assert!(matches!(error, RegionError::Steep { .. }), "{error}");
    let mut twice = graph([0.1, 0.06], 0.005, |_, _| 0.0);
    let above = graph([0.1, 0.06], 0.005, |_, _| 0.02);
    let first = twice.vertices.len() as u32;
    twice.vertices.extend(above.vertices);
    twice
        .triangles
        .extend(above.triangles.iter().map(|t| t.map(|i| i + first)));
    let error = draft(&twice, &options()).unwrap_err();
    assert!(matches!(error, RegionError::Overlap { .. }), "{error}");
    let flat = graph([0.1, 0.06], 0.005, |_, _| 0.0);
    for (change, word) in [
        (
            (|o| o.margin_m = Some(0.04)) as fn(&mut RegionOptions<'_>),
            "--margin-m",
        ),
        (|o| o.spacing_m = Some(1e-5), "--spacing-m"),
        (|o| o.approach = Some([0.0, 0.0, 1.0]), "faces"),
        (
            |o| o.outline_m = Some(vec![[1.0, 0.0, 0.0], [1.1, 0.0, 0.0], [1.0, 0.1, 0.0]]),
            "--outline",
        ),
        (|o| o.touch_m = Some([1.0, 1.0, 0.0]), "--touch"),
        (|o| o.approach = Some([0.0; 3]), "--approach"),
        (|o| o.force_n = 5000.0, "force.reference_n"),
        (|o| o.radius_m = f64::NAN, "--radius-m"),
    ] {
        let mut how = options();
        change(&mut how);
        let error = draft(&flat, &how).unwrap_err().to_string();
        assert!(error.contains(word), "{word}: {error}");
    }
}

/// Points of a waved sheet with noise of 0.3 mm, gaps and strays.
#[test]
fn a_scan_becomes_the_surface_that_it_shows() {
    let height = |x: f64, y: f64| 0.004 * (50.0 * x).sin() + 0.003 * (40.0 * y).cos();
    let mut scan = Mesh::default();
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24) - 0.5
    };
    for k in 0..160_u32 * 120 {
        let (x, y) = (f64::from(k % 160) * 0.001, f64::from(k / 160) * 0.001);
        if (x - 0.05).hypot(y - 0.05) < 0.002 {
            continue;
        }
        let noise = if k % 97 == 0 {
            0.05 * random()
        } else {
            0.0006 * random()
        };
        scan.vertices.push(Vector3::new(x, y, height(x, y) + noise));
    }
    let how = RegionOptions {
        spacing_m: Some(0.012),
        outline_m: Some(vec![
            [0.02, 0.02, 0.0],
            [0.12, 0.02, 0.0],
            [0.12, 0.09, 0.0],
            [0.02, 0.09, 0.0],
        ]),
        margin_m: Some(0.004),
        ..options()
    };
    let draft = draft(&scan, &how).unwrap();
    let surface = draft.task.path.expected_surface().unwrap();
    let mut worst = 0.0_f64;
    for i in 0..=20 {
        for j in 0..=14 {
            let (x, y) = (0.02 + 0.005 * f64::from(i), 0.02 + 0.005 * f64::from(j));
            let place = draft.plane.place(&Vector3::new(x, y, height(x, y)));
            worst = worst.max((surface.height_m(&place.xy()) - place.z).abs());
        }
    }
    println!("scan: worst {:.2} mm", worst * 1e3);
    assert!(worst < 0.0015, "{worst}");
    assert_eq!(draft.rings_m.len(), 1);
    // Six gaps of 12 mm at most over 62 mm.
    assert!((6..=8).contains(&draft.strokes), "{}", draft.strokes);
}

#[test]
fn the_start_pose_is_above_the_place_where_the_tool_touches_down() {
    let turn = Rotation3::from_euler_angles(0.2, -0.15, 0.0);
    let mut mesh = graph([0.1, 0.06], 0.005, |x, _| 2.0 * x * x);
    for v in &mut mesh.vertices {
        *v = turn * *v + Vector3::new(0.4, -0.05, 0.1);
    }
    let model = ModelData::builtin("ur5").unwrap();
    let tool = Pose::new(
        Vector3::new(0.0, 0.0, 0.165),
        nalgebra::UnitQuaternion::identity(),
    );
    let how = RegionOptions {
        approach: None,
        arm: Some((&model, &tool)),
        ..options()
    };
    let draft = draft(&mesh, &how).unwrap();
    let arm = tangent_mechanics::Arm::<6>::new(&model).unwrap();
    let q = tangent_mechanics::Joints::<6>::from_column_slice(&draft.start_joints_rad);
    let pose = arm.base_from_flange(&q) * tool;
    let above = pose.translation() - draft.plane.origin;
    assert!((above - draft.plane.normal * 0.03).norm() < 1e-5, "{above}");
    assert!(pose.z_axis().angle(&-draft.plane.normal) < 0.3);
    assert_eq!(draft.task.start.as_ref().unwrap().joints_rad.len(), 6);
}

#[test]
fn the_radius_of_coverage_is_that_of_the_tip_where_it_is_known() {
    let mesh = graph([0.1, 0.06], 0.005, |_, _| 0.0);
    let how = RegionOptions {
        dose_n_s_per_cm2: Some([0.8, 8.0]),
        margin_m: None,
        ..options()
    };
    let text = draft(&mesh, &how)
        .unwrap()
        .text
        .replace("radius_m = 0.01\n", "");
    let program = |tip: Tip| {
        let mut task: Task = text.parse().unwrap();
        task.complete(&tip);
        tangent_control::Program::new(&task, &tangent_control::ControllerConfig::default())
            .map(|program| program.task.coverage.unwrap().radius_m)
    };
    assert_eq!(program(Tip::Flat { radius_m: 0.011 }).unwrap(), Some(0.011));
    for tip in [Tip::Unknown, Tip::Round { radius_m: 0.01 }] {
        let error = program(tip).unwrap_err().to_string();
        assert!(
            error.contains("coverage.radius_m") && error.contains("[tool.tip]"),
            "{error}"
        );
    }
}

#[test]
fn an_edge_pass_runs_along_the_edge() {
    let mesh = graph([0.1, 0.06], 0.005, |_, _| 0.0);
    let how = RegionOptions {
        edge_pass: true,
        ..options()
    };
    let draft = draft(&mesh, &how).unwrap();
    let tangent_control::PathSpec::Strokes(path) = &draft.task.path else {
        panic!("no strokes");
    };
    let ring = path
        .strokes
        .iter()
        .find(|s| s.points_m.first() == s.points_m.last());
    let ring: Vec<Vector2<f64>> = ring.unwrap().points_m.iter().map(|p| (*p).into()).collect();
    let length_m: f64 = ring.windows(2).map(|ends| (ends[1] - ends[0]).norm()).sum();
    assert!((length_m - 0.24).abs() < 0.002, "{length_m}");
}

/// The bug that it guards against: in the order of the strokes, nothing said any more which of
/// them run along an edge.
#[test]
fn strokes_along_edges_have_a_force_and_a_speed_of_their_own() {
    let mesh = graph([0.1, 0.06], 0.005, |_, _| 0.0);
    for (pattern, edge_pass) in [(Pattern::Raster, true), (Pattern::Contour, false)] {
        let how = RegionOptions {
            pattern,
            edge_pass,
            edge_force_n: Some(3.0),
            edge_speed_m_per_s: Some(0.01),
            holes_m: vec![vec![
                [0.04, 0.025, 0.0],
                [0.06, 0.025, 0.0],
                [0.06, 0.035, 0.0],
                [0.04, 0.035, 0.0],
            ]],
            margin_m: Some(0.005),
            ..options()
        };
        let draft = draft(&mesh, &how).unwrap();
        let tangent_control::PathSpec::Strokes(path) = &draft.task.path else {
            panic!("no strokes");
        };
        let lines = strokes(&draft, |_, _| 0.0);
        // Distance from the edges of the plate and of the hole, m.
        let away = |p: &Vector3<f64>| {
            let plate = p.x.min(0.1 - p.x).min(p.y).min(0.06 - p.y);
            let beside = [0.04 - p.x, p.x - 0.06, 0.025 - p.y, p.y - 0.035];
            let hole = Vector2::new(
                beside[0].max(beside[1]).max(0.0),
                beside[2].max(beside[3]).max(0.0),
            );
            plate.min(hole.norm())
        };
        let mut at_edge = 0;
        for (stroke, line) in path.strokes.iter().zip(&lines) {
            let furthest = line.iter().map(away).fold(0.0, f64::max);
            let own = (stroke.force_n, stroke.speed_m_per_s);
            // The first and the last row of a raster are beside an edge, too.
            if furthest < 0.0055 && stroke.points_m.first() == stroke.points_m.last() {
                assert_eq!(own, (Some(3.0), Some(0.01)), "{pattern:?}");
                at_edge += 1;
            } else {
                assert_eq!(own, (None, None), "{pattern:?}");
            }
        }
        assert_eq!((at_edge, draft.edge_strokes), (2, 2), "{pattern:?}");
        assert!(lines.len() > 4);
    }
}

#[test]
fn a_force_of_edges_needs_strokes_along_them() {
    let mesh = graph([0.1, 0.06], 0.005, |_, _| 0.0);
    let refused = |how: RegionOptions<'_>| draft(&mesh, &how).unwrap_err().to_string();
    let said = refused(RegionOptions {
        edge_force_n: Some(3.0),
        ..options()
    });
    for words in ["--edge-force-n", "3", "--edge-pass", "--pattern contour"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let said = refused(RegionOptions {
        edge_pass: true,
        edge_speed_m_per_s: Some(2.0),
        ..options()
    });
    for words in ["--edge-speed", "2", "0.001 to 0.25"] {
        assert!(said.contains(words), "{words}: {said}");
    }
}
