//! The dose against closed forms, and the bounds of the map.

use std::f64::consts::PI;

use proptest::prelude::*;

use super::*;

const RADIUS_M: f64 = 0.01;
const DT_S: f64 = 0.002;

fn pressed(point: Vector3<f64>, normal: Vector3<f64>, force_n: f64) -> Pressed {
    Pressed {
        point,
        normal,
        force_n,
        reference_n: 5.0,
    }
}

fn sum(map: &DoseMap) -> f64 {
    map.cells().iter().map(|c| c.impulse_n_s).sum()
}

/// A disk of radius r that slides with speed v and force F leaves on its middle line the
/// pressure F/(pi r²) for the time 2r/v, and at a distance y from it for 2 sqrt(r² - y²)/v.
#[test]
fn a_stroke_leaves_the_dose_of_the_closed_form_on_any_slope() {
    let (force, speed) = (5.0, 0.05);
    let way = |y: f64| 2.0 * (RADIUS_M * RADIUS_M - y * y).max(0.0).sqrt();
    let closed = |y: f64| force / (PI * RADIUS_M * RADIUS_M * 1e4) * way(y) / speed;
    for lean in [0.0, 0.4, 0.9] {
        let mut map = DoseMap::new(RADIUS_M);
        // The frame of the map is that of the first contact, beside the stroke.
        map.press(&pressed(Vector3::y() * 9.0, Vector3::z(), 1e-9), DT_S);
        let normal = Vector3::new(-f64::sin(lean), 0.0, f64::cos(lean));
        let along = Vector3::new(f64::cos(lean), 0.0, f64::sin(lean));
        let steps = (0.2 / speed / DT_S) as usize;
        for step in 0..steps {
            let x = step as f64 * DT_S * speed;
            map.press(&pressed(along * x, normal, force), DT_S);
        }
        let mut compared = 0;
        for cell in map.cells() {
            let (x, y) = (cell.point.dot(&along), cell.point.y);
            if !(0.03..0.17).contains(&x) || y.abs() > 0.7 * RADIUS_M {
                continue;
            }
            let error = cell.dose() / closed(y) - 1.0;
            assert!(error.abs() < 0.08, "lean {lean}, y {y}: {error}");
            compared += 1;
        }
        assert!(compared > 150, "{compared}");
        let total = force * steps as f64 * DT_S;
        assert!((sum(&map) - total).abs() < 1e-6, "{} {total}", sum(&map));
    }
}

/// Around a cylinder, every side has the same dose, also where the plane of the grid changes.
#[test]
fn the_dose_around_a_cylinder_is_the_same_on_every_side() {
    let (radius, turns, steps) = (0.05, 20, 4000);
    let mut map = DoseMap::new(RADIUS_M);
    for step in 0..turns * steps {
        let angle = 2.0 * PI * f64::from(step) / f64::from(steps);
        let normal = Vector3::new(angle.cos(), angle.sin(), 0.0);
        map.press(&pressed(normal * radius, normal, 4.0), DT_S);
    }
    let total = 4.0 * f64::from(turns * steps) * DT_S;
    assert!((sum(&map) / total - 1.0).abs() < 1e-9);
    // Each eighth of the ring has an eighth of the impulse.
    let mut parts = [0.0; 8];
    for cell in map.cells() {
        let angle = cell.point.y.atan2(cell.point.x).rem_euclid(2.0 * PI);
        parts[((angle / (PI / 4.0)) as usize).min(7)] += cell.impulse_n_s;
    }
    for part in parts {
        assert!((part / total * 8.0 - 1.0).abs() < 0.15, "{parts:?}");
    }
}

#[test]
fn gaps_between_strokes_and_spots_with_too_much_are_marked() {
    let mut map = DoseMap::new(RADIUS_M);
    let stroke = |map: &mut DoseMap, y: f64, passes: usize| {
        for _ in 0..passes {
            for step in 0..2000 {
                let x = 0.1 * f64::from(step) / 2000.0;
                let at = Vector3::new(x, y, 0.0);
                map.press(&pressed(at, Vector3::z(), 5.0), DT_S);
            }
        }
    };
    stroke(&mut map, 0.0, 1);
    assert!(map.judge(None).holes.is_empty());
    // A gap of 12 mm between the strokes, which lies open at both ends.
    stroke(&mut map, 0.032, 1);
    let judged = map.judge(None);
    assert!(judged.is_default && judged.over_cm2 == 0.0);
    let inside = |p: &Vector3<f64>| (0.005..0.027).contains(&p.y) && p.z.abs() < 1e-9;
    assert!(judged.holes.iter().all(inside), "{:?}", judged.holes);
    assert!(
        (8.0..20.0).contains(&judged.hole_cm2),
        "{}",
        judged.hole_cm2
    );
    // A third stroke closes the gap; five more on it are too much.
    stroke(&mut map, 0.016, 1);
    let closed = map.judge(Some(judged.band));
    assert!(closed.hole_cm2 < 0.1 * judged.hole_cm2, "{closed:?}");
    stroke(&mut map, 0.016, 5);
    let over = map.judge(Some(judged.band));
    assert!(!over.is_default && over.over_cm2 > 10.0, "{over:?}");
}

#[test]
fn hours_stay_within_bounds_and_keep_the_impulse() {
    let mut map = DoseMap::new(RADIUS_M);
    for step in 0..60_000 {
        let way = f64::from(step) * 0.004;
        let at = Vector3::new(way % 2.0, (way / 2.0).floor() * 0.02, 0.0);
        map.press(&pressed(at, Vector3::z(), 5.0), 0.05);
        assert!(map.cells().len() <= CELLS_MAX);
    }
    assert!(map.epoch() > 0, "the cells became larger");
    assert!((sum(&map) / map.impulse_n_s() - 1.0).abs() < 1e-9);
    let epoch = map.epoch();
    map.clear();
    assert!(map.epoch() > epoch && map.cells().is_empty() && map.impulse_n_s() == 0.0);
}

#[test]
fn a_gap_in_time_is_counted_and_not_added() {
    let mut map = DoseMap::new(RADIUS_M);
    let one = pressed(Vector3::zeros(), Vector3::z(), 5.0);
    for dt in [0.5, f64::NAN, 0.0, -1.0] {
        map.press(&one, dt);
    }
    assert_eq!((map.impulse_n_s(), map.missed_s()), (0.0, 0.5));
    assert!(map.cells().is_empty());
}

#[test]
fn only_what_has_changed_is_sent_again() {
    let mut map = DoseMap::new(RADIUS_M);
    map.press(&pressed(Vector3::zeros(), Vector3::z(), 5.0), DT_S);
    let seen = map.revision();
    assert_eq!(map.changed(0).count(), map.cells().len());
    map.press(&pressed(Vector3::x(), Vector3::z(), 5.0), DT_S);
    assert!(map.changed(seen).all(|c| c.point.x > 0.9));
    assert!(map.changed(seen).count() > 0 && map.changed(map.revision()).count() == 0);
}

proptest! {
    /// Whatever the tool does, no impulse is lost or made.
    #[test]
    fn the_sum_is_the_integral_of_the_force(
        steps in proptest::collection::vec(
            ((-0.3..0.3_f64, -0.3..0.3_f64, -0.3..0.3_f64), (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 0.0..50.0_f64),
            1..40,
        ),
    ) {
        let mut map = DoseMap::new(0.004);
        let mut total = 0.0;
        for ((x, y, z), (a, b, c), force) in steps {
            let Some(normal) = Vector3::new(a, b, c).try_normalize(1e-3) else { continue };
            map.press(&pressed(Vector3::new(x, y, z), normal, force), DT_S);
            total += force * DT_S;
        }
        prop_assert!((sum(&map) - total).abs() <= 1e-9 * total.max(1.0));
        prop_assert!(map.cells().iter().all(|cell| cell.dose().is_finite()));
    }
}
