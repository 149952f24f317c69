//! Rows of a raster: cuts of the surface with planes, placed by lengths along the surface.
//!
//! Rows are parallel to the plane's x axis. From one row to the next, the way along the surface at
//! constant x is `s(x) = ∫ sqrt(1 + (∂h/∂y)²) dy`. The next row is where the longest `s(x)` over
//! the region reaches the spacing; then all rows are spread evenly in this measure.

use nalgebra::Vector2;
use tangent_control::fill::{Points, Polygon};

use crate::height_map::HeightMap;

/// Distance of the first and last row from the edge that they run along, m.
const INSIDE_M: f64 = 3e-4;
/// Halvings of the interval in which the even spacing is searched.
const HALVINGS: u32 = 40;

/// Rows within a polygon, no further apart along the surface than `spacing_m`.
pub(crate) fn rows(map: &HeightMap, within: &Polygon, spacing_m: f64) -> Vec<Points> {
    let (low, high) = within.bounds();
    let cut = |y: f64| -> Vec<Points> {
        let chords = within.chords(y).into_iter();
        chords.map(|ends| ends.to_vec()).collect()
    };
    let (first, last) = (low.y + INSIDE_M, high.y - INSIDE_M);
    if last <= first {
        return cut(0.5 * (low.y + high.y));
    }
    let ways = Ways::of(map, within);
    let place = |spacing_m: f64| ways.rows(first, last, spacing_m);
    let count = place(spacing_m).len();
    // The smallest spacing with the same number of rows spreads them evenly.
    let (mut even_m, mut below_m) = (spacing_m, 0.25 * spacing_m);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (even_m + below_m);
        if place(middle).len() > count {
            below_m = middle;
        } else {
            even_m = middle;
        }
    }
    let places = place(even_m);
    places.into_iter().flat_map(cut).collect()
}

/// Ways along the surface at constant x, between the rows of the grid.
struct Ways {
    low_y: f64,
    cell_m: f64,
    /// For each step along y, its length on the surface for each x of the region, m; zero outside.
    steps: Vec<Vec<f64>>,
    columns: usize,
}

impl Ways {
    fn of(map: &HeightMap, within: &Polygon) -> Self {
        let step = |j: usize, i: usize| {
            let node = j * map.columns + i;
            let (h0, h1) = (map.heights_m[node], map.heights_m[node + map.columns]);
            let middle = map.place(node) + Vector2::new(0.0, 0.5 * map.cell_m);
            let length_m = map.cell_m.hypot(h1 - h0);
            if length_m.is_finite() && within.contains(&middle) {
                length_m
            } else {
                0.0
            }
        };
        let rows = 0..map.rows - 1;
        Self {
            low_y: map.low.y,
            cell_m: map.cell_m,
            steps: rows
                .map(|j| (0..map.columns).map(|i| step(j, i)).collect())
                .collect(),
            columns: map.columns,
        }
    }

    /// Places of rows from `first` to `last`, no further apart than `spacing_m`.
    fn rows(&self, first: f64, last: f64, spacing_m: f64) -> Vec<f64> {
        let mut rows = vec![first];
        let mut y = first;
        let mut ways = vec![0.0_f64; self.columns];
        while y < last {
            let j = (((y - self.low_y) / self.cell_m + 1e-9).floor().max(0.0)) as usize;
            let Some(steps) = self.steps.get(j) else {
                break;
            };
            let end = (self.low_y + (j + 1) as f64 * self.cell_m).min(last);
            let share = (end - y) / self.cell_m;
            // How far the row may go within this step.
            let mut goes = 1.0_f64;
            for (way_m, step_m) in ways.iter().zip(steps) {
                let wanted = way_m + step_m * share;
                if wanted > spacing_m + 1e-12 {
                    goes = goes.min((spacing_m - way_m) / (step_m * share));
                }
            }
            let goes = goes.max(0.0);
            for (way_m, step_m) in ways.iter_mut().zip(steps) {
                *way_m += step_m * share * goes;
            }
            if goes < 1.0 {
                y += (end - y) * goes;
                rows.push(y);
                ways.fill(0.0);
            } else {
                y = end;
            }
        }
        if last - rows[rows.len() - 1] > 1e-9 {
            rows.push(last);
        }
        rows
    }
}
