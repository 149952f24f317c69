//! Dose of pressure on the surface: the time integral of the pressure at each place, N*s/cm².
//!
//! The pressing force is spread evenly over a disk of the tip's radius in the tangent plane, and
//! added up in a grid. The grid lies in the tangent plane of the first contact. Where the surface
//! leans away from it by more than 60°, it lies in another plane of the same frame, so each cell
//! covers its true area on the surface. The sum over all cells is the time integral of the force.

use std::collections::{BTreeMap, HashMap, HashSet};

use crate::{Pressed, cross_axes};
use nalgebra::Vector3;

/// Cells across the radius of the tip.
const CELLS_PER_RADIUS: f64 = 4.0;
/// Smallest cell, m.
const CELL_MIN_M: f64 = 0.001;
/// Largest number of cells. Beyond it, cells become twice as large.
pub const CELLS_MAX: usize = 16_384;
/// More than the cells under a tip.
const UNDER_MAX: usize = 128;
/// Longest time between two states that is added up, s. A longer gap is not, and is counted.
pub const STEP_MAX_S: f64 = 0.1;
/// Least cosine between the normal and the axis of the present plane.
const LEAN_MIN: f64 = 0.5;
/// Widest gap between covered places that counts as a hole, in radii of the tip.
const HOLE_RADII: f64 = 4.0;
/// The wanted dose, if the cell file does not state it, as shares of the median.
const DEFAULT_BAND: [f64; 2] = [0.5, 2.0];

/// Plane of the grid and cell in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
struct Place {
    plane: u8,
    i: i64,
    j: i64,
}

/// A cell of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Number of the cell; it stays the same within an epoch.
    pub number: usize,
    /// Middle of the cell on the surface, m.
    pub point: Vector3<f64>,
    /// Unit normal of the surface.
    pub normal: Vector3<f64>,
    /// Time integral of the force on the cell, N*s.
    pub impulse_n_s: f64,
    /// Area of the surface in the cell, cm².
    pub area_cm2: f64,
    revision: u64,
    place: Place,
}

impl Cell {
    /// The dose, N*s/cm².
    pub fn dose(&self) -> f64 {
        self.impulse_n_s / self.area_cm2
    }
}

/// The wanted dose, and what the map says of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Judgement {
    /// Least and most wanted dose, N*s/cm².
    pub band: [f64; 2],
    /// Whether the band is the default.
    pub is_default: bool,
    /// Area with at least some dose, cm².
    pub area_cm2: f64,
    /// Area within the band, cm².
    pub good_cm2: f64,
    /// Area above the band, cm².
    pub over_cm2: f64,
    /// Middles of the cells that are below the band between covered places, m.
    pub holes: Vec<Vector3<f64>>,
    /// Their area in the plane of the grid, cm².
    pub hole_cm2: f64,
}

/// Dose of one task.
pub struct DoseMap {
    radius_m: f64,
    cell_min_m: f64,
    cell_m: f64,
    /// Axes of the frame of the first contact: two along the surface, and the normal.
    axes: Option<[Vector3<f64>; 3]>,
    plane: u8,
    cells: Vec<Cell>,
    places: HashMap<Place, usize>,
    revision: u64,
    epoch: u64,
    impulse_n_s: f64,
    /// Time during contact that was not added up, s.
    missed_s: f64,
}

impl DoseMap {
    /// An empty map for a tip of this radius, m.
    pub fn new(radius_m: f64) -> Self {
        let cell_m = (radius_m / CELLS_PER_RADIUS).max(CELL_MIN_M);
        Self {
            radius_m,
            cell_min_m: cell_m,
            cell_m,
            axes: None,
            plane: 4,
            cells: Vec::new(),
            places: HashMap::new(),
            revision: 0,
            epoch: 0,
            impulse_n_s: 0.0,
            missed_s: 0.0,
        }
    }

    /// Removes all dose, for a new task.
    pub fn clear(&mut self) {
        let epoch = self.epoch + 1;
        *self = Self::new(self.radius_m);
        self.cell_m = self.cell_min_m;
        self.epoch = epoch;
    }

    /// Adds the force of `dt_s` seconds.
    pub fn press(&mut self, pressed: &Pressed, dt_s: f64) {
        if dt_s > STEP_MAX_S {
            self.missed_s += dt_s;
            return;
        }
        if dt_s.is_nan() || dt_s <= 0.0 {
            return;
        }
        let axes = *self.axes.get_or_insert_with(|| {
            let (x, y) = cross_axes(&pressed.normal);
            [x, y, pressed.normal]
        });
        if self.cells.len() + UNDER_MAX > CELLS_MAX {
            self.thin();
        }
        self.plane = plane_for(&axes, &pressed.normal, self.plane);
        self.revision += 1;
        let impulse = pressed.force_n * dt_s;
        self.impulse_n_s += impulse;
        let under = self.under(&axes, pressed);
        let sum: f64 = under.iter().map(|one| one.3).sum();
        for (place, point, area_cm2, weight) in under {
            self.add(
                place,
                point,
                pressed.normal,
                area_cm2,
                impulse * weight / sum,
            );
        }
    }

    /// Cells under the tip: place, point on the surface, area in cm², and share.
    fn under(
        &self,
        axes: &[Vector3<f64>; 3],
        pressed: &Pressed,
    ) -> Vec<(Place, Vector3<f64>, f64, f64)> {
        let (a, b, d) = plane_axes(axes, self.plane);
        let (p, n, h, r) = (pressed.point, pressed.normal, self.cell_m, self.radius_m);
        let (u, v, lean) = (p.dot(&a), p.dot(&b), n.dot(&d));
        let area_cm2 = h * h / lean * 1e4;
        let cell = |x: f64| (x / h).floor() as i64;
        let lift = |du: f64, dv: f64| -(n.dot(&a) * du + n.dot(&b) * dv) / lean;
        let mut under = Vec::new();
        for i in cell(u - r)..=cell(u + r) {
            for j in cell(v - r)..=cell(v + r) {
                let (du, dv) = ((i as f64 + 0.5) * h - u, (j as f64 + 0.5) * h - v);
                let away = a * du + b * dv + d * lift(du, dv);
                // A cell on the rim has a part of the force.
                let weight = ((r - away.norm()) / h + 0.5).clamp(0.0, 1.0);
                if weight > 0.0 {
                    let plane = self.plane;
                    under.push((Place { plane, i, j }, p + away, area_cm2, weight));
                }
            }
        }
        // Cells that are larger than the tip may all have their middles beside it.
        if under.is_empty() {
            let (i, j, plane) = (cell(u), cell(v), self.plane);
            under.push((Place { plane, i, j }, p, area_cm2, 1.0));
        }
        under
    }

    fn add(
        &mut self,
        place: Place,
        point: Vector3<f64>,
        normal: Vector3<f64>,
        area_cm2: f64,
        impulse_n_s: f64,
    ) {
        if let Some(&number) = self.places.get(&place) {
            let cell = &mut self.cells[number];
            cell.impulse_n_s += impulse_n_s;
            (cell.point, cell.normal, cell.area_cm2) = (point, normal, area_cm2);
            cell.revision = self.revision;
            return;
        }
        let number = self.cells.len();
        self.places.insert(place, number);
        self.cells.push(Cell {
            number,
            point,
            normal,
            impulse_n_s,
            area_cm2,
            revision: self.revision,
            place,
        });
    }

    /// Doubles the cells until a quarter of them is free. The impulse is kept.
    fn thin(&mut self) {
        while self.cells.len() > CELLS_MAX / 4 * 3 {
            self.cell_m *= 2.0;
            let old = std::mem::take(&mut self.cells);
            self.places.clear();
            for cell in old {
                let place = Place {
                    i: cell.place.i.div_euclid(2),
                    j: cell.place.j.div_euclid(2),
                    ..cell.place
                };
                if let Some(&number) = self.places.get(&place) {
                    self.cells[number].impulse_n_s += cell.impulse_n_s;
                    continue;
                }
                let number = self.cells.len();
                self.places.insert(place, number);
                self.cells.push(Cell {
                    number,
                    place,
                    area_cm2: cell.area_cm2 * 4.0,
                    ..cell
                });
            }
        }
        self.epoch += 1;
    }

    /// All cells.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Cells that have changed after `revision`.
    pub fn changed(&self, revision: u64) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(move |c| c.revision > revision)
    }

    /// Number of changes so far in this epoch.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Changes whenever numbers of cells lose their meaning.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Edge of a cell in the plane of the grid, m.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Time integral of the force, N*s.
    pub fn impulse_n_s(&self) -> f64 {
        self.impulse_n_s
    }

    /// Time in contact that is not in the map, because states of the cell were missing, s.
    pub fn missed_s(&self) -> f64 {
        self.missed_s
    }

    /// Compares the map with a wanted band, or with the default band.
    pub fn judge(&self, wanted: Option<[f64; 2]>) -> Judgement {
        let band = wanted.unwrap_or_else(|| {
            let median = self.median();
            DEFAULT_BAND.map(|share| share * median)
        });
        let mut found = Judgement {
            band,
            is_default: wanted.is_none(),
            ..Judgement::default()
        };
        for cell in &self.cells {
            found.area_cm2 += cell.area_cm2;
            if cell.dose() > band[1] {
                found.over_cm2 += cell.area_cm2;
            } else if cell.dose() >= band[0] {
                found.good_cm2 += cell.area_cm2;
            }
        }
        found.holes = self.holes(band[0]);
        found.hole_cm2 = found.holes.len() as f64 * self.cell_m * self.cell_m * 1e4;
        found
    }

    fn median(&self) -> f64 {
        let mut doses: Vec<f64> = self.cells.iter().map(Cell::dose).collect();
        if doses.is_empty() {
            return 0.0;
        }
        let middle = doses.len() / 2;
        *doses.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Middles of the cells with less than `least` between two covered cells of the same row or
    /// column of the grid that are near each other.
    fn holes(&self, least: f64) -> Vec<Vector3<f64>> {
        let mut lines: BTreeMap<(u8, bool, i64), Vec<(i64, usize)>> = BTreeMap::new();
        for cell in self.cells.iter().filter(|c| c.dose() >= least) {
            let Place { plane, i, j } = cell.place;
            let row = lines.entry((plane, true, i)).or_default();
            row.push((j, cell.number));
            let column = lines.entry((plane, false, j)).or_default();
            column.push((i, cell.number));
        }
        let widest = (HOLE_RADII * self.radius_m / self.cell_m).ceil() as i64;
        let (mut places, mut holes) = (HashSet::new(), Vec::new());
        for ((plane, is_row, line), mut covered) in lines {
            covered.sort_unstable();
            for pair in covered.windows(2) {
                let [(from, first), (to, last)] = [pair[0], pair[1]];
                if to - from - 1 > widest {
                    continue;
                }
                for k in from + 1..to {
                    let (i, j) = if is_row { (line, k) } else { (k, line) };
                    if places.insert(Place { plane, i, j }) {
                        let share = (k - from) as f64 / (to - from) as f64;
                        let (first, last) = (self.cells[first].point, self.cells[last].point);
                        holes.push(first + (last - first) * share);
                    }
                }
            }
        }
        holes
    }
}

/// Axes of a plane of the grid: two in it, and its own. Planes are numbered by axis and sign.
fn plane_axes(axes: &[Vector3<f64>; 3], plane: u8) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    let k = usize::from(plane / 2);
    let sign = if plane.is_multiple_of(2) { 1.0 } else { -1.0 };
    (axes[(k + 1) % 3], axes[(k + 2) % 3], axes[k] * sign)
}

/// The present plane, unless the surface leans too far away from it.
fn plane_for(axes: &[Vector3<f64>; 3], normal: &Vector3<f64>, present: u8) -> u8 {
    let along = |plane: u8| plane_axes(axes, plane).2.dot(normal);
    if along(present) >= LEAN_MIN {
        return present;
    }
    let best = (0..6).max_by(|a, b| along(*a).total_cmp(&along(*b)));
    best.unwrap_or(present)
}

#[cfg(test)]
mod tests {
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
}
