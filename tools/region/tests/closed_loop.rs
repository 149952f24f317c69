//! Regions of meshes in the closed loop: what `docs/region.md` states, by true places and forces.

#![allow(clippy::unwrap_used)]

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use tangent_control::fill::Polygon;
use tangent_control::{CoverageResult, Pattern, Phase, Task};
use tangent_region::{Draft, Mesh, RegionOptions, Selection, draft};
use tangent_simulation::{AdmittanceLoop, AdmittanceScenario, FileError, Surface};

const RADIUS_M: f64 = 0.008;
/// N*s/cm².
const BAND: [f64; 2] = [0.8, 14.0];
/// Nodes of a mesh along x, and their distance, m.
const COLUMNS: u32 = 41;
const STEP_M: f64 = 0.0025;
/// Cell of the independent map, m.
const CELL_M: f64 = 0.002;

fn scenario(name: &str, task: &str) -> AdmittanceScenario {
    let file = format!("{}/../../scenarios/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&file).unwrap();
    let (cell, _) = text.split_once("[task]").unwrap();
    let task: toml::Table = task.parse().unwrap();
    let mut table: toml::Table = cell.parse().unwrap();
    table.insert("task".into(), task.into());
    // Without any noise, an axis across the approach reads the same for ever, as a stuck one does.
    let set = [
        "duration_s=600.0",
        "plant.sensor.noise_n_per_sqrt_hz=0.0002",
        "plant.sensor.noise_nm_per_sqrt_hz=0.00001",
    ]
    .map(str::to_owned);
    let none = |_: &str| Err(FileError::new("no file"));
    AdmittanceScenario::parse(&file, &table.to_string(), &set, &none).unwrap()
}

/// The true surface as a mesh of 100 mm by 90 mm around the place where the scenario starts, and
/// that place.
fn true_mesh(scenario: &AdmittanceScenario) -> (Mesh, Vector3<f64>) {
    let config = &scenario.plant.surface;
    let surface = Surface::new(&config.shape, &config.pose()).unwrap();
    let near = Vector3::from(scenario.plant.start.near_m);
    let start = surface.query(&near);
    let (start, n) = (start.point, start.normal);
    let x_axis = (Vector3::x() - n * n.x).normalize();
    let y_axis = n.cross(&x_axis);
    let (columns, rows, step) = (COLUMNS, 37_u32, STEP_M);
    let mut vertices = Vec::new();
    for j in 0..rows {
        for i in 0..columns {
            let (x, y) = (f64::from(i) * step - 0.03, f64::from(j) * step - 0.03);
            let mut at = start + x_axis * x + y_axis * y + n * 0.05;
            for _ in 0..200 {
                at -= n * surface.query(&at).distance;
            }
            vertices.push(at);
        }
    }
    let mut triangles = Vec::new();
    for j in 0..rows - 1 {
        for i in 0..columns - 1 {
            let k = j * columns + i;
            triangles.push([k, k + 1, k + columns + 1]);
            triangles.push([k, k + columns + 1, k + columns]);
        }
    }
    let mesh = Mesh {
        vertices,
        triangles,
        degenerate: 0,
    };
    (mesh, start)
}

/// The mesh where a person believes it to be: displaced by 5 mm and tilted by 5 degrees.
fn displaced(mut mesh: Mesh, about: &Vector3<f64>) -> Mesh {
    let turn = UnitQuaternion::new(Vector3::new(0.7, -0.7, 0.1).normalize() * 5f64.to_radians());
    let by = Vector3::new(1.5, -1.5, -4.5).normalize() * 0.005;
    for v in &mut mesh.vertices {
        *v = turn * (*v - about) + about + by;
    }
    mesh
}

/// A plate with a hole, drawn on the mesh; corners are nodes of it.
fn region<'a>(mesh: &Mesh, pattern: Pattern) -> RegionOptions<'a> {
    let at = |x: f64, y: f64| {
        let [i, j] = [x, y].map(|v| ((v + 0.03) / STEP_M).round() as usize);
        mesh.vertices[j * COLUMNS as usize + i].into()
    };
    RegionOptions {
        name: "part",
        source: "a test",
        selection: Selection::All,
        approach: None,
        rows_along: [1.0, 0.0, 0.0],
        outline_m: Some(vec![
            at(0.0, 0.02),
            at(0.065, 0.02),
            at(0.065, 0.055),
            at(0.0, 0.055),
        ]),
        holes_m: vec![vec![
            at(0.025, 0.03),
            at(0.0425, 0.03),
            at(0.0425, 0.045),
            at(0.025, 0.045),
        ]],
        pattern,
        edge_pass: false,
        edge_force_n: None,
        edge_speed_m_per_s: None,
        radius_m: RADIUS_M,
        spacing_m: None,
        margin_m: Some(0.003),
        touch_m: Some(at(0.0, 0.0)),
        force_n: 5.0,
        speed_m_per_s: 0.03,
        dose_n_s_per_cm2: Some(BAND),
        clearance_m: 0.03,
        arm: None,
    }
}

struct Run {
    end: Phase,
    fault: Option<tangent_control::Fault>,
    force_max_n: f64,
    lifts: usize,
    /// Places over the plane, slopes there, and impulses, N*s.
    presses: Vec<(Vector2<f64>, Vector2<f64>, f64)>,
    result: Option<CoverageResult>,
}

fn run(name: &str, draft: &Draft) -> Run {
    let scenario = scenario(name, &draft.text);
    let mut cell = AdmittanceLoop::new(&scenario).unwrap();
    let mut run = Run {
        end: Phase::Idle,
        fault: None,
        force_max_n: 0.0,
        lifts: 0,
        presses: Vec::new(),
        result: None,
    };
    let plane = draft.plane;
    let mut first: Option<Vector3<f64>> = None;
    for _ in 0..(scenario.duration_s / 0.008) as usize {
        cell.step(&mut |c| {
            let phase = c.output.phase;
            run.lifts += usize::from(phase == Phase::Lift && run.end != Phase::Lift);
            run.end = phase;
            run.fault = c.output.fault;
            let truth = c.truth;
            let force_n = truth.wrench.force.dot(&truth.normal);
            run.force_max_n = run.force_max_n.max(force_n);
            if truth.in_contact && phase.is_pressing() {
                let at = truth.base_from_tool.translation();
                let origin = *first.get_or_insert(at);
                let way = at - origin;
                let n = Vector3::new(
                    truth.normal.dot(&plane.x),
                    truth.normal.dot(&plane.y),
                    truth.normal.dot(&plane.normal),
                );
                run.presses.push((
                    Vector2::new(way.dot(&plane.x), way.dot(&plane.y)),
                    -n.xy() / n.z,
                    force_n * c.input.dt_s,
                ));
            }
        });
        if !run.end.is_active() && run.end != Phase::Idle {
            break;
        }
    }
    run.result = cell.controller().coverage_result();
    run
}

/// Share of the region whose true dose is within the band; 2 mm along the edges are left out.
fn true_share(run: &Run, draft: &Draft) -> f64 {
    const EDGE_M: f64 = 0.002;
    let polygon = Polygon::new(&draft.rings_m[0], &draft.rings_m[1..]);
    let (low, high) = polygon.bounds();
    let size = ((high - low) / CELL_M).map(|x| x.ceil() as usize);
    let middle = |i: usize, j: usize| low + Vector2::new(i as f64 + 0.5, j as f64 + 0.5) * CELL_M;
    let mut doses = vec![0.0; size.x * size.y];
    let area_cm2 = std::f64::consts::PI * RADIUS_M * RADIUS_M * 1e4;
    for (at, slope, impulse) in &run.presses {
        let reach = (RADIUS_M / CELL_M).ceil() as i64 + 1;
        let cell = ((at - low) / CELL_M).map(|x| x as i64);
        for j in (cell.y - reach).max(0)..=(cell.y + reach).min(size.y as i64 - 1) {
            for i in (cell.x - reach).max(0)..=(cell.x + reach).min(size.x as i64 - 1) {
                let off = middle(i as usize, j as usize) - at;
                if off.norm().hypot(slope.dot(&off)) < RADIUS_M {
                    doses[j as usize * size.x + i as usize] += impulse / area_cm2;
                }
            }
        }
    }
    let (mut good, mut all) = (0, 0);
    for j in 0..size.y {
        for i in 0..size.x {
            let p = middle(i, j);
            if polygon.contains(&p) && polygon.edge_distance_m(&p) > EDGE_M {
                all += 1;
                good += usize::from((BAND[0]..=BAND[1]).contains(&doses[j * size.x + i]));
            }
        }
    }
    f64::from(good as u32) / f64::from(all)
}

const SURFACES: [&str; 6] = [
    "plane",
    "pipe_ideal",
    "cone_ideal",
    "sphere",
    "torus",
    "sheet",
];

fn covers(pattern: Pattern, moved: bool) {
    for name in SURFACES {
        let any =
            "name = \"a\"\nforce.reference_n = 5.0\npath = { kind = \"stay\", duration_s = 1.0 }";
        let (mesh, start) = true_mesh(&scenario(name, any));
        let mesh = if moved { displaced(mesh, &start) } else { mesh };
        let draft = draft(&mesh, &region(&mesh, pattern)).unwrap();
        assert_eq!(draft.text.parse::<Task>().unwrap(), draft.task);
        let run = run(name, &draft);
        let share = true_share(&run, &draft);
        let result = run.result.as_ref().unwrap();
        if std::env::var("DUMP").is_ok() {
            std::fs::write(format!("/tmp/draft-{name}.toml"), &draft.text).unwrap();
        }
        println!(
            "{name} {pattern:?} {}: {:.1} cm2, steepest {:.0} deg, {} strokes, {} lifts, at most {:.1} N, \
             {:?}, true share {share:.4}",
            if moved { "displaced" } else { "true" },
            draft.area_cm2,
            draft.steepest_deg,
            draft.strokes,
            run.lifts,
            run.force_max_n,
            result
        );
        assert_eq!((run.end, run.fault), (Phase::Done, None), "{name}");
        assert!(result.share >= 0.99, "{name}: {result:?}");
        assert!(share >= 0.99, "{name}: {share}");
        assert!(run.force_max_n < 12.0, "{name}: {}", run.force_max_n);
    }
}

/// At least 99 % of the region within the band.
#[test]
fn rows_of_the_true_mesh_cover_every_surface_of_the_suite() {
    covers(Pattern::Raster, false);
}

/// The mesh is a guess: touch corrects it.
#[test]
fn rows_of_a_mesh_that_is_displaced_and_tilted_cover_every_surface() {
    covers(Pattern::Raster, true);
}

#[test]
fn rings_of_a_mesh_that_is_displaced_and_tilted_cover_every_surface() {
    covers(Pattern::Contour, true);
}

#[test]
fn spirals_of_the_true_mesh_cover_every_surface() {
    covers(Pattern::Spiral, false);
}

/// A force that varies along a stroke, and along a whole path.
#[test]
fn a_force_profile_is_followed_along_a_stroke_and_along_the_path() {
    const PLACES: [[f64; 2]; 3] = [[0.0, 3.0], [0.04, 8.0], [0.08, 4.0]];
    let wanted = |way_m: f64| {
        if way_m < 0.04 {
            3.0 + 125.0 * way_m
        } else {
            8.0 - 100.0 * (way_m.min(0.08) - 0.04)
        }
    };
    let stroke = "kind = \"strokes\"\nspeed_m_per_s = 0.02\n[[path.strokes]]\n\
                  points_m = [[0.0, 0.0], [0.08, 0.0]]\n";
    let tasks = [
        format!(
            "name = \"a\"\nforce.reference_n = 3.0\n[path]\n{stroke}force_profile = {PLACES:?}\n"
        ),
        format!(
            "name = \"a\"\nforce.reference_n = 3.0\nforce.profile = {PLACES:?}\n[path]\n{stroke}"
        ),
    ];
    for (name, task) in [("plane", &tasks[0]), ("pipe_ideal", &tasks[1])] {
        let scenario = scenario(name, task);
        let mut cell = AdmittanceLoop::new(&scenario).unwrap();
        let (mut first, mut end) = (None, Phase::Idle);
        let (mut squares, mut worst, mut count) = (0.0, 0.0_f64, 0.0);
        while end.is_active() || end == Phase::Idle {
            cell.step(&mut |c| {
                end = c.output.phase;
                if end != Phase::Slide {
                    return;
                }
                let way_m = {
                    let at = c.truth.base_from_tool.translation();
                    (at - *first.get_or_insert(at)).norm()
                };
                let error_n = c.truth.wrench.force.dot(&c.truth.normal) - wanted(way_m);
                squares += error_n * error_n;
                worst = worst.max(error_n.abs());
                count += 1.0;
            });
        }
        let rmse_n = f64::sqrt(squares / count);
        println!("{name}: force RMSE {rmse_n:.3} N, worst {worst:.2} N");
        assert_eq!(end, Phase::Done, "{name}");
        // The force loop follows a ramp of 2.5 N/s about 0.25 s late.
        assert!(rmse_n < 0.8 && worst < 1.6, "{name}: {rmse_n} {worst}");
    }
    // A change that the reference does not follow is refused.
    let steep = tasks[0].replace("0.02\n[[", "0.1\n[[");
    let task: Task = steep.parse().unwrap();
    let config = tangent_control::ControllerConfig::default();
    let error = tangent_control::Program::new(&task, &config)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("9.1 N/s") && error.contains("at most 8 N/s"),
        "{error}"
    );
    let both = tasks[0].replace("force_profile =", "force_n = 3.0\nforce_profile =");
    let error = both.parse::<Task>().unwrap_err().to_string();
    assert!(error.contains("path.strokes[0].force_n"), "{error}");
}
