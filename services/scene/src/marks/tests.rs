use std::collections::{BTreeMap, BTreeSet};

use nalgebra::UnitQuaternion;
use tangent_schemas::cdr;
use tangent_schemas::standard::MarkerArray;

use super::blocks::{BLOCK, POINTS_MAX};
use super::*;

/// Kind of an order to remove a marker.
const DELETE: i32 = 2;

/// A viewer: it keeps the newest marker of each name and number.
#[derive(Default)]
struct Viewer {
    shown: BTreeMap<(String, i32), Marker>,
    bytes: usize,
}

impl Viewer {
    fn take(&mut self, markers: Vec<Marker>) {
        let mut bytes = Vec::new();
        let array = MarkerArray { markers };
        cdr::encode(&array, &mut bytes).unwrap();
        self.bytes += bytes.len();
        for marker in array.markers {
            let key = (marker.ns.to_string(), marker.id);
            if marker.action == DELETE {
                self.shown.remove(&key);
            } else {
                self.shown.insert(key, marker);
            }
        }
    }

    fn points(&self, name: &str) -> Vec<Vector3<f64>> {
        let of = self.shown.iter().filter(|((ns, _), _)| ns == name);
        of.flat_map(|(_, m)| m.points.iter().map(Vector3::from))
            .collect()
    }

    fn blocks(&self, name: &str) -> usize {
        self.shown.keys().filter(|(ns, _)| ns == name).count()
    }
}

/// The tool presses on the plane z = 0 at a point, with a share of the wanted force.
fn seen(now: Instant, x: f64, y: f64, force: f64) -> Seen {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Seen {
        now,
        stamp: 1,
        base_from_tool: Pose::new(Vector3::new(x, y, 0.0), down),
        world_from_base: Pose::identity(),
        control: ControlState {
            activation: 1,
            phase: Phase::Slide as u8,
            normal: (&Vector3::z()).into(),
            force_reference_n: 5.0,
            force_n: 5.0 * force,
            path_reference: (&Vector3::new(x, y, 0.0)).into(),
            ..ControlState::default()
        },
        estimates: Vec::new(),
    }
}

const TICK: Duration = Duration::from_millis(50);

#[test]
fn a_stroke_is_seen_as_path_surface_and_coverage() {
    let mut marks = Marks::new(Tip::Flat { radius_m: 0.01 });
    marks.begin(1, None, &Pose::identity());
    let (mut viewer, begun) = (Viewer::default(), Instant::now());
    for tick in 0..400 {
        let x = 0.1 * f64::from(tick.min(200)) / 200.0;
        // The second half with twice the force; then it stands.
        let force = if tick > 100 { 2.0 } else { 1.0 };
        viewer.take(marks.draw(&seen(begun + TICK * tick, x, 0.0, force)));
    }
    for name in ["path/wanted", "path/tool", "surface"] {
        let points = viewer.points(name);
        let reach = points.iter().map(|p| p.x).fold(0.0, f64::max);
        assert!((0.095..=0.1).contains(&reach), "{name}: {reach}");
        assert!(points.len() >= 30, "{name}: {}", points.len());
    }
    let covered = viewer.points("coverage");
    let wide = covered.iter().map(|p| p.y.abs()).fold(0.0, f64::max);
    assert!((0.006..=0.01).contains(&wide), "{wide}");
    // A stadium of 0.1 m by 0.02 m, in cells of a third of the radius.
    let area = covered.len() as f64 * (0.01f64 / 3.0).powi(2);
    assert!((0.6..=1.4).contains(&(area / (0.1 * 0.02))), "{area} m²");
    let surface = &viewer.shown[&("surface".to_owned(), 0)];
    assert_eq!(surface.colors.len(), surface.points.len());
    let (first, last) = (&surface.colors[0], surface.colors.last().unwrap());
    assert!(
        first.g > 0.99 && first.r < 0.01,
        "the wanted force is green"
    );
    assert!(last.r > 0.99 && last.g < 0.01, "twice the force is red");
}

#[test]
fn hours_of_wiping_stay_within_bounds() {
    let mut marks = Marks::new(Tip::Unknown);
    marks.begin(1, None, &Pose::identity());
    let (mut viewer, begun) = (Viewer::default(), Instant::now());
    let ticks = 20 * 3600 * 3;
    let mut hours = Vec::new();
    for tick in 0..ticks {
        // A raster of a square of 2 m, again and again.
        let way = f64::from(tick) * 0.005;
        let (line, along) = ((way / 2.0).floor(), way % 2.0);
        let y = (line * 0.01) % 2.0;
        viewer.take(marks.draw(&seen(begun + TICK * tick, along, y, 1.0)));
        if (tick + 1) % (20 * 3600) == 0 {
            hours.push(std::mem::take(&mut viewer.bytes));
        }
    }
    for name in ["path/wanted", "path/tool", "surface", "coverage"] {
        let blocks = viewer.blocks(name);
        assert!(
            blocks > 1 && blocks <= POINTS_MAX / BLOCK,
            "{name}: {blocks}"
        );
        assert!(viewer.points(name).len() <= POINTS_MAX + blocks, "{name}");
    }
    // 40 kB/s with the arrows, in every hour.
    for bytes in hours {
        assert!(bytes < 40_000 * 3600, "{bytes} bytes in an hour");
    }
    let covered: BTreeSet<i64> = viewer
        .points("coverage")
        .iter()
        .map(|p| (p.x * 10.0) as i64 * 100 + (p.y * 10.0) as i64)
        .collect();
    assert!(
        covered.len() >= 350,
        "all over the square: {}",
        covered.len()
    );
}

#[test]
fn a_new_task_removes_what_was_drawn_of_the_one_before() {
    let mut marks = Marks::new(Tip::Unknown);
    marks.begin(1, None, &Pose::identity());
    let (mut viewer, begun) = (Viewer::default(), Instant::now());
    for tick in 0..200 {
        viewer.take(marks.draw(&seen(
            begun + TICK * tick,
            0.002 * f64::from(tick),
            0.0,
            1.0,
        )));
    }
    assert!(viewer.blocks("coverage") > 0 && viewer.blocks("path/tool") > 0);
    assert!(!marks.is_new(1) && marks.is_new(2));
    marks.begin(2, None, &Pose::identity());
    let mut idle = seen(begun + TICK * 201, 0.0, 0.0, 0.0);
    idle.control.phase = Phase::Approach as u8;
    viewer.take(marks.draw(&idle));
    for name in ["path/wanted", "path/tool", "surface", "coverage"] {
        assert_eq!(viewer.blocks(name), 0, "{name}");
    }
}

/// A force or a place that is not a number is drawn nowhere.
#[test]
fn what_is_not_a_number_is_left_out() {
    let mut marks = Marks::new(Tip::Unknown);
    marks.begin(1, None, &Pose::identity());
    let now = Instant::now();
    let mut bad = seen(now, 0.0, 0.0, f64::NAN);
    bad.control.wrench.force.x = f64::NAN;
    bad.control.path_reference.x = f64::NAN;
    let mut viewer = Viewer::default();
    viewer.take(marks.draw(&bad));
    let mut lost = seen(now + TICK, f64::NAN, 0.0, 1.0);
    lost.control.phase = Phase::Hold as u8;
    viewer.take(marks.draw(&lost));
    assert_eq!(viewer.blocks("force"), 1, "of the second");
    for name in ["surface", "coverage", "path/wanted"] {
        assert_eq!(viewer.blocks(name), 0, "{name}");
    }
}
