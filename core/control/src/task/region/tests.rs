use proptest::prelude::*;

use super::*;

fn region(keys: &str) -> Region {
    let text = format!("spacing_m = 0.01\nspeed_m_per_s = 0.03\n{keys}");
    toml::from_str(&text).unwrap()
}

const PLATE: &str = "outline_m = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]\n";
const HOLE: &str = "holes_m = [[[0.04, 0.04], [0.06, 0.04], [0.06, 0.06], [0.04, 0.06]]]\n";

/// Largest distance of a point of the region from the strokes, m; the region less its margin.
fn widest_gap_m(region: &Region) -> f64 {
    let strokes = region.plan().unwrap();
    let polygon = region.within_margin();
    let (low, high) = polygon.bounds();
    let mut widest: f64 = 0.0;
    for i in 0..=100 {
        for j in 0..=100 {
            let share = Vector2::new(f64::from(i) / 100.0, f64::from(j) / 100.0);
            let at = low + (high - low).component_mul(&share);
            if !polygon.contains(&at) {
                continue;
            }
            let away = strokes
                .iter()
                .flat_map(|s| s.points.windows(2))
                .map(|e| (polygon::nearest_on(&e[0], &e[1], &at) - at).norm())
                .fold(f64::INFINITY, f64::min);
            widest = widest.max(away);
        }
    }
    widest
}

#[test]
fn every_pattern_fills_a_region_with_a_hole_and_keeps_its_margin() {
    for pattern in ["raster", "contour", "spiral"] {
        let region = region(&format!(
            "{PLATE}{HOLE}pattern = \"{pattern}\"\nmargin_m = 0.004"
        ));
        // Half a spacing, and a little more in the corners of rings.
        let gap = widest_gap_m(&region);
        assert!(gap < 0.0075, "{pattern}: {gap}");
        let (outer, strokes) = (region.polygon(), region.plan().unwrap());
        for ends in strokes.iter().flat_map(|s| s.points.windows(2)) {
            for k in 0..=10 {
                let at = ends[0] + (ends[1] - ends[0]) * (f64::from(k) / 10.0);
                let away = outer.edge_distance_m(&at);
                assert!(
                    outer.contains(&at) && away > 0.0039,
                    "{pattern}: {at} {away}"
                );
            }
        }
    }
}

#[test]
fn a_raster_at_an_angle_fills_as_well() {
    let region = region(&format!("{PLATE}{HOLE}angle_rad = 0.6"));
    let gap = widest_gap_m(&region);
    assert!(gap < 0.0075, "{gap}");
}

#[test]
fn the_way_between_strokes_is_short() {
    let strokes = region(&format!("{PLATE}{HOLE}")).plan().unwrap();
    let lifts = strokes.iter().filter(|s| s.lifts).count();
    assert!(lifts <= 2, "{lifts}");
    let mut way = 0.0;
    for pair in strokes.windows(2) {
        way += (pair[1].points[0] - pair[0].points.last().unwrap()).norm();
    }
    // Eleven rows, ten steps of a spacing, and the ways to the other side of the hole.
    assert!(way < 0.3, "{way}");
}

#[test]
fn a_spiral_is_one_stroke_where_rings_pass_into_each_other() {
    let strokes = region(&format!("{PLATE}pattern = \"spiral\""))
        .plan()
        .unwrap();
    assert_eq!(strokes.len(), 1);
    let rings = region(&format!("{PLATE}pattern = \"contour\""))
        .plan()
        .unwrap();
    assert!(rings.len() >= 5 && rings.iter().all(|r| !r.lifts));
}

#[test]
fn bad_regions_are_refused_with_key_value_and_what_is_allowed() {
    let bow = "outline_m = [[0.0, 0.0], [0.1, 0.1], [0.1, 0.0], [0.0, 0.1]]";
    let fold = "outline_m = [[0.0, 0.0], [0.1, 0.0], [0.05, 0.0], [0.05, 0.1]]";
    let outside = format!("{PLATE}holes_m = [[[0.2, 0.2], [0.3, 0.2], [0.3, 0.3]]]");
    let crossing = format!("{PLATE}holes_m = [[[0.05, 0.05], [0.2, 0.05], [0.05, 0.08]]]");
    let nested = format!(
        "{PLATE}holes_m = [[[0.02, 0.02], [0.08, 0.02], [0.05, 0.08]], [[0.05, 0.03], [0.055, 0.03], [0.05, 0.035]]]"
    );
    for (keys, words) in [
        (
            bow.to_owned(),
            ["`path.outline_m`", "edge 1 meets edge 3", "do not meet"],
        ),
        (
            fold.to_owned(),
            ["`path.outline_m`", "meets", "do not meet"],
        ),
        (
            "outline_m = [[0.0, 0.0], [0.1, 0.1]]".into(),
            ["`path.outline_m`", "2 different", "3 points"],
        ),
        (
            "outline_m = [[0.0, 0.0], [0.1, 0.1], [0.1, 0.1], [0.0, 0.0]]".into(),
            ["`path.outline_m`", "2 different", "3 points"],
        ),
        (
            "outline_m = [[0.0, nan], [0.1, 0.1], [0.1, 0.0]]".into(),
            ["`path.outline_m`", "NaN", "-2 to 2"],
        ),
        (
            outside,
            [
                "`path.holes_m[0]`",
                "a hole at (0.2, 0.2)",
                "inside the outline",
            ],
        ),
        (
            crossing,
            ["`path.outline_m`", "of path.holes_m[0]", "do not meet"],
        ),
        (
            nested,
            [
                "`path.holes_m[1]`",
                "a hole in path.holes_m[0]",
                "outside other holes",
            ],
        ),
        (
            format!("{PLATE}margin_m = 0.06"),
            ["`path.margin_m`", "0.06", "leaves a part"],
        ),
        (
            format!("{PLATE}lift_m = 0.1"),
            ["`path.lift_m`", "0.1", "0.005 to 0.02"],
        ),
        (
            format!("{PLATE}pattern = \"spiral\"\nangle_rad = 0.1"),
            ["`path.angle_rad`", "0.1", "raster"],
        ),
    ] {
        let error = region(&keys).check().unwrap_err().to_string();
        for word in words {
            assert!(error.contains(word), "{keys}: {error}");
        }
    }
    let fine = Region {
        spacing_m: 0.0005,
        outline_m: vec![[0.0, 0.0], [1.9, 0.0], [1.9, 1.9], [0.0, 1.9]],
        ..region(PLATE)
    };
    assert!(
        fine.check()
            .unwrap_err()
            .to_string()
            .contains("at most 2000")
    );
}

/// A ring around `middle` whose corners have these distances from it.
fn star(middle: [f64; 2], radii: &[f64]) -> Vec<[f64; 2]> {
    let corner = |(k, r): (usize, &f64)| {
        let angle = std::f64::consts::TAU * k as f64 / radii.len() as f64;
        [middle[0] + r * angle.cos(), middle[1] + r * angle.sin()]
    };
    radii.iter().enumerate().map(corner).collect()
}

proptest! {
    /// Whatever the polygon, its strokes keep the margin, and the ways that are not lifted stay
    /// inside.
    #[test]
    fn strokes_stay_in_any_region(
        outer in prop::collection::vec(0.03f64..0.15, 3..12),
        inner in prop::collection::vec(0.003f64..0.014, 3..8),
        pattern in 0..3_usize,
        margin_m in 0.0f64..0.01,
        spacing_m in 0.004f64..0.03,
        angle_rad in -3.0f64..3.0,
    ) {
        let pattern = [Pattern::Raster, Pattern::Spiral, Pattern::Contour][pattern];
        let region = Region {
            outline_m: star([0.02, -0.01], &outer),
            holes_m: vec![star([0.02, -0.01], &inner)],
            pattern,
            margin_m,
            spacing_m,
            angle_rad: if pattern == Pattern::Raster { angle_rad } else { 0.0 },
            ..region(PLATE)
        };
        // Not every drawn star leaves something, or has its hole inside.
        let Ok(strokes) = region.plan() else {
            return Ok(());
        };
        let polygon = region.polygon();
        let over_m = (OVER_SHARE * spacing_m).max(1e-4);
        let keeps = |p: &Vector2<f64>, over_m: f64| {
            let away = polygon.edge_distance_m(p);
            if polygon.contains(p) { away > margin_m - over_m } else { margin_m < over_m && away < over_m }
        };
        let mut at: Option<Vector2<f64>> = None;
        for stroke in &strokes {
            prop_assert!(!stroke.points.is_empty());
            for ends in stroke.points.windows(2) {
                for k in 0..=10 {
                    let p = ends[0] + (ends[1] - ends[0]) * (f64::from(k) / 10.0);
                    // A chord of a rounded corner, or between points of a spiral.
                    prop_assert!(keeps(&p, 2e-4 + 0.02 * margin_m), "{:?} {}", pattern, p);
                }
            }
            if let (Some(at), false) = (at, stroke.lifts) {
                for k in 0..=10 {
                    let p = at + (stroke.points[0] - at) * (f64::from(k) / 10.0);
                    prop_assert!(keeps(&p, over_m + 2e-4 + 0.02 * margin_m), "way {}", p);
                }
            }
            at = stroke.points.last().copied();
        }
    }

    /// Any text of numbers is a region or is refused.
    #[test]
    fn any_points_are_planned_or_refused(
        outline_m in prop::collection::vec(prop::array::uniform2(-0.1f64..0.1), 0..9),
        holes_m in prop::collection::vec(prop::collection::vec(prop::array::uniform2(-0.1f64..0.1), 0..5), 0..3),
        margin_m in 0.0f64..0.02,
    ) {
        let region = Region { outline_m, holes_m, margin_m, ..region(PLATE) };
        let _ = region.check();
    }
}
