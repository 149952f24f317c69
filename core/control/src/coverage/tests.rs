use std::f64::consts::PI;

use proptest::prelude::*;

use super::*;
use crate::PathSpec;

const DT_S: f64 = 0.004;
const FORCE_N: f64 = 5.0;

fn task(keys: &str, coverage: &str) -> Task {
    let text = format!(
        "name = \"a\"\nforce.reference_n = {FORCE_N}\n[path]\nkind = \"region\"\nspacing_m = 0.008\n\
         margin_m = 0.003\nspeed_m_per_s = 0.03\n{keys}\n[coverage]\nradius_m = 0.008\n{coverage}"
    );
    text.parse().unwrap()
}

const PLATE: &str = "outline_m = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.06], [0.0, 0.06]]";
const HOLE: &str = "holes_m = [[[0.04, 0.02], [0.06, 0.02], [0.06, 0.04], [0.04, 0.04]]]";
const BAND: &str = "dose_n_s_per_cm2 = [0.8, 8.0]";

fn coverage(task: &Task) -> (Coverage, Path) {
    let mut path = Path::new(&task.path, 0.1, 1.0).unwrap();
    let coverage = Coverage::new(task, &mut path, (0.1, 1.0)).unwrap().unwrap();
    (coverage, path)
}

/// Presses along a path that is followed exactly, except above the surface. Returns its end.
fn follow(coverage: &mut Coverage, path: &Path, time_s: &mut f64) -> Vector2<f64> {
    let mut t = 0.0;
    let mut done = 0;
    while t < path.duration_s() {
        if let Some(lift) = path.lift(done)
            && t >= lift.start_s
        {
            t = lift.end_s;
            done += 1;
            continue;
        }
        coverage.press(
            &path.at(t).position,
            &Vector2::zeros(),
            FORCE_N,
            *time_s,
            DT_S,
        );
        t += DT_S;
        *time_s += DT_S;
    }
    path.at(path.duration_s()).position
}

/// Runs all rounds.
fn run(task: &Task) -> CoverageResult {
    let (mut coverage, mut path) = coverage(task);
    let (mut time_s, mut progress) = (0.0, 0.0);
    assert_eq!(coverage.progress(0.0), 0.0);
    loop {
        let end = follow(&mut coverage, &path, &mut time_s);
        let ended = coverage.progress(1.0);
        assert!(ended > progress && ended < 1.0, "{progress} {ended}");
        progress = ended;
        let goes_on = coverage.end_round(end, &mut path);
        let taken = coverage.take_result(false);
        assert_eq!(
            taken.map(|r| r.outcome),
            goes_on.then_some(CoverageOutcome::Open)
        );
        assert_eq!(coverage.take_result(false), None);
        if !goes_on {
            assert_eq!(coverage.progress(1.0), 1.0);
            let last = coverage.take_result(true).unwrap();
            assert_eq!(coverage.take_result(true), None);
            assert_eq!(coverage.result(true), last);
            return last;
        }
        assert!((coverage.progress(0.0) - progress).abs() < 1e-12);
        while coverage.is_planning() {
            coverage.plan(&mut path);
        }
    }
}

/// A disk of radius r that slides with speed v and force F leaves at a distance y from its middle
/// line the pressure F/(pi r²) for the time 2 sqrt(r² - y²)/v.
#[test]
fn a_stroke_leaves_the_dose_of_the_closed_form() {
    let (mut coverage, _) = coverage(&task(PLATE, BAND));
    let (speed, r) = (0.03, 0.008);
    let steps = (0.1 / speed / DT_S) as usize;
    for step in 0..steps {
        let x = step as f64 * DT_S * speed;
        coverage.press(
            &Vector2::new(x, 0.03),
            &Vector2::zeros(),
            FORCE_N,
            0.0,
            DT_S,
        );
    }
    let mut compared = 0;
    for ([x, y], dose) in coverage.cells() {
        let beside = (y - 0.03).abs();
        if (0.02..0.08).contains(&x) && beside < 0.7 * r {
            let closed =
                FORCE_N / (PI * r * r * 1e4) * 2.0 * (r * r - beside * beside).sqrt() / speed;
            assert!((dose / closed - 1.0).abs() < 0.08, "{y}: {dose} {closed}");
            compared += 1;
        }
    }
    assert!(compared > 100, "{compared}");
}

#[test]
fn rows_too_far_apart_are_closed_in_the_second_round() {
    for keys in [HOLE, "angle_rad = 0.7", "pattern = \"contour\"", ""] {
        let mut task = task(&format!("{PLATE}\n{keys}"), BAND);
        if let PathSpec::Region(region) = &mut task.path {
            region.spacing_m = 0.02;
        }
        let result = run(&task);
        assert!(result.share_by_round[0] < 0.97, "{keys}: {result:?}");
        assert!(
            result.share >= 0.99 && result.rounds <= 3,
            "{keys}: {result:?}"
        );
        assert_eq!(
            (result.outcome, result.share_min),
            (CoverageOutcome::Met, 0.99)
        );
    }
}

#[test]
fn passes_are_counted_and_completed() {
    for (passes, rounds) in [(1, 3), (4, 6)] {
        let result = run(&task(
            &format!("{PLATE}\n{HOLE}"),
            &format!("passes = {passes}\nrounds_max = {rounds}"),
        ));
        assert!(result.share >= 0.99, "{passes}: {result:?}");
        assert_eq!(result.over_cm2, 0.0);
    }
}

#[test]
fn a_limit_of_rounds_ends_the_task_with_its_holes() {
    let mut task = task(PLATE, &format!("{BAND}\nrounds_max = 1"));
    if let PathSpec::Region(region) = &mut task.path {
        region.spacing_m = 0.03;
    }
    let result = run(&task);
    assert_eq!((result.rounds, result.share_by_round.len()), (1, 1));
    assert!(result.holes >= 1 && result.under_cm2 > 5.0, "{result:?}");
    assert_eq!(result.outcome, CoverageOutcome::RoundsMax);
}

#[test]
fn the_largest_hole_is_told_with_its_place() {
    let (mut coverage, mut path) = coverage(&task(PLATE, &format!("{BAND}\nshare_min = 1.0")));
    // Rows of presses leave out one rectangle of 20 x 20 mm, and a corner.
    let left_out = |x: f64, y: f64| {
        (0.03..0.07).contains(&x) && (0.01..0.05).contains(&y) || x > 0.095 && y > 0.055
    };
    for (i, j) in (0..=100).flat_map(|i| (0..=60).map(move |j| (i, j))) {
        let (x, y) = (f64::from(i) * 0.001, f64::from(j) * 0.001);
        if !left_out(x, y) {
            let at = Vector2::new(x, y);
            coverage.press(&at, &Vector2::zeros(), FORCE_N, 0.0, 0.05);
        }
    }
    assert_eq!(coverage.take_result(false), None);
    let result = coverage.take_result(true).unwrap();
    assert_eq!(coverage.take_result(true), None);
    assert_eq!(
        (result.outcome, result.rounds, result.share_by_round.len()),
        (CoverageOutcome::TaskEnded, 1, 0)
    );
    assert!(result.holes >= 1, "{result:?}");
    let [x, y] = result.largest_hole_m;
    assert!(
        (x - 0.05).abs() < 0.002 && (y - 0.03).abs() < 0.002,
        "{result:?}"
    );
    let largest = result.largest_hole_cm2;
    assert!(
        largest > 4.0 && largest <= result.under_cm2 + 1e-9,
        "{result:?}"
    );

    // Planned after the end of the round: it is open.
    assert!(coverage.end_round(Vector2::zeros(), &mut path));
    assert_eq!(coverage.result(false).outcome, CoverageOutcome::Open);
}

#[test]
fn what_no_stroke_reaches_is_given_up() {
    let (mut coverage, mut path) = coverage(&task(PLATE, BAND));
    for cell in &mut coverage.grid.cells {
        cell.reached_from = None;
    }
    assert!(!coverage.end_round(Vector2::zeros(), &mut path));
    assert_eq!(coverage.take_result(false), None);
    let result = coverage.take_result(true).unwrap();
    assert_eq!(result.outcome, CoverageOutcome::OutOfReach);
}

#[test]
fn bad_coverage_is_refused() {
    let base = task(PLATE, BAND);
    let spec = |change: &dyn Fn(&mut Task)| {
        let mut task = base.clone();
        change(&mut task);
        task.check().unwrap_err().to_string()
    };
    fn of(task: &mut Task) -> &mut CoverageSpec {
        task.coverage.as_mut().unwrap()
    }
    let error = spec(&|t| of(t).radius_m = Some(f64::NAN));
    assert!(
        error.contains("`coverage.radius_m`") && error.contains("0.001 to 0.1"),
        "{error}"
    );
    let error = spec(&|t| of(t).passes = Some(2));
    assert!(
        error.contains("both") && error.contains("one of them"),
        "{error}"
    );
    let error = spec(&|t| of(t).dose_n_s_per_cm2 = None);
    assert!(error.contains("neither"), "{error}");
    let error = spec(&|t| of(t).dose_n_s_per_cm2 = Some([2.0, 1.0]));
    assert!(error.contains("coverage.dose_n_s_per_cm2[1]"), "{error}");
    let error = spec(&|t| of(t).radius_m = Some(0.004));
    assert!(
        error.contains("`path.margin_m`") && error.contains("0.0024"),
        "{error}"
    );
    let error = spec(&|t| t.learning = Some(crate::LearningSpec::of("lid")));
    assert!(error.contains("`learning`"), "{error}");
    let error = spec(&|t| t.path = PathSpec::Stay(crate::Stay { duration_s: 1.0 }));
    assert!(error.contains("region"), "{error}");
    // An area that a grid of the tip's size cannot hold.
    let mut large = base.clone();
    if let PathSpec::Region(region) = &mut large.path {
        region.outline_m = vec![[0.0, 0.0], [1.5, 0.0], [1.5, 1.5], [0.0, 1.5]];
    }
    let mut path = Path::new(&large.path, 0.1, 1.0).unwrap();
    let error = Coverage::new(&large, &mut path, (0.1, 1.0))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("`path.outline_m`") && error.contains("1.500 m by 1.500 m"),
        "{error}"
    );
}

proptest! {
    /// Whatever was pressed, a round is planned in finitely many strokes that stay where the tool's
    /// middle may be, and no impulse is made.
    #[test]
    fn any_round_ends_and_stays_inside(
        presses in prop::collection::vec((-0.02f64..0.12, -0.02f64..0.08, 0.0f64..200.0), 0..60),
        angle in -1.5f64..1.5,
    ) {
        let task = task(&format!("{PLATE}\n{HOLE}\nangle_rad = {angle}"), BAND);
        let (mut coverage, mut path) = coverage(&task);
        let mut total = 0.0;
        for (x, y, force_n) in presses {
            coverage.press(&Vector2::new(x, y), &Vector2::zeros(), force_n, 0.0, 0.1);
            total += 0.1 * force_n;
        }
        let sum: f64 = coverage.grid.cells.iter().map(|cell| cell.impulse_n_s).sum();
        prop_assert!(sum <= total * (1.0 + 1e-9));
        let PathSpec::Region(region) = &task.path else {
            return Ok(());
        };
        if coverage.end_round(Vector2::new(0.02, 0.01), &mut path) {
            let mut strokes = 1;
            while coverage.is_planning() {
                coverage.plan(&mut path);
                strokes += 1;
                prop_assert!(strokes <= STROKES_MAX + 1);
            }
            let (mut t, mut done) = (0.0, 0);
            while t < path.duration_s() {
                if let Some(lift) = path.lift(done) && t >= lift.start_s {
                    t = lift.end_s;
                    done += 1;
                }
                let p = path.at(t).position;
                let inside = region.polygon().contains(&p) && region.polygon().edge_distance_m(&p) > 0.002;
                prop_assert!(inside, "{} at {}", p, t);
                t += 0.05;
            }
        }
    }
}
