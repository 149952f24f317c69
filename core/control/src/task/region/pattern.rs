//! Patterns that fill a polygon: parallel rows, rings along its edges, and a spiral of those rings.
//!
//! Called while a task is loaded; allocates.

use nalgebra::{Rotation2, Vector2};

use super::order::Points;
use super::polygon::{Polygon, area_m2, nearest_on};

/// Distance of the first and last row from the edge that they run along, m.
const INSIDE_M: f64 = 1e-6;
/// A spiral leaves the polygon by no more than this, m.
const OVER_M: f64 = 1e-4;
/// Distance between points of a spiral, m.
const SPIRAL_STEP_M: f64 = 0.002;
/// The next ring of a spiral is nowhere further away than this many spacings.
const NEXT_SPACINGS: f64 = 1.8;
/// Share of the spacing within which rings that shrink to nothing leave no strip open.
const CORE_SHARE: f64 = 0.5;

/// Rows at `angle_rad` to the x axis, no further apart than `spacing_m`.
pub(crate) fn raster(polygon: &Polygon, spacing_m: f64, angle_rad: f64) -> Vec<Points> {
    let turned = polygon.turned(-angle_rad);
    let back = Rotation2::new(angle_rad);
    let (low, high) = turned.bounds();
    let height = high.y - low.y - 2.0 * INSIDE_M;
    let gaps = (height / spacing_m - 1e-9).ceil().max(1.0) as usize;
    let mut rows = Vec::new();
    for row in 0..=gaps {
        let y = low.y + INSIDE_M + height * row as f64 / gaps as f64;
        let chords = turned.chords(y).into_iter();
        rows.extend(chords.map(|ends| ends.map(|end| back * end).to_vec()));
    }
    rows
}

/// A closed ring: its first point is also its last one. With the number of its distance from the
/// edge.
pub type Ring = (usize, Points);

/// Closed rings along the edges, from the edges inwards, `spacing_m` apart.
fn rings(polygon: &Polygon, spacing_m: f64) -> Vec<Ring> {
    let mut rings = Vec::new();
    for level in 0.. {
        let inset = polygon.inset(spacing_m * level as f64);
        if inset.is_empty() {
            // What the last rings surround may be wider than a row: one more ring in its middle.
            let within = polygon.inset(spacing_m * (level as f64 - CORE_SHARE));
            rings.extend(within.rings.into_iter().map(|ring| (level, closed(ring))));
            break;
        }
        rings.extend(inset.rings.into_iter().map(|ring| (level, closed(ring))));
    }
    rings
}

fn closed(mut ring: Points) -> Points {
    ring.push(ring[0]);
    ring
}

/// Rings along the edges, `spacing_m` apart.
pub(crate) fn contour(polygon: &Polygon, spacing_m: f64) -> Vec<Points> {
    (rings(polygon, spacing_m).into_iter())
        .map(|(_, ring)| ring)
        .collect()
}

/// Rings along the edges that pass into each other. A ring that does not pass into exactly one
/// next ring ends its spiral.
pub(crate) fn spiral(polygon: &Polygon, spacing_m: f64) -> Vec<Points> {
    spiral_of(&rings(polygon, spacing_m), polygon, spacing_m)
}

/// Rings that pass into each other, within `polygon`.
pub fn spiral_of(rings: &[Ring], polygon: &Polygon, spacing_m: f64) -> Vec<Points> {
    let near = |from: &Points, to: &Points| {
        let furthest = to.iter().map(|p| distance_m(from, p)).fold(0.0, f64::max);
        furthest < NEXT_SPACINGS * spacing_m
    };
    let inner = |i: usize| {
        let (level, ring) = &rings[i];
        let mut next = (0..rings.len()).filter(|&j| {
            rings[j].0 == level + 1
                && (area_m2(&rings[j].1) > 0.0) == (area_m2(ring) > 0.0)
                && near(ring, &rings[j].1)
        });
        next.next().filter(|_| next.next().is_none())
    };
    let mut used = vec![false; rings.len()];
    let mut spirals = Vec::new();
    for first in 0..rings.len() {
        if std::mem::replace(&mut used[first], true) {
            continue;
        }
        let mut points = dense(&rings[first].1);
        let mut present = first;
        while let Some(next) = inner(present).filter(|&next| !used[next]) {
            let from = dense(&rotated(&rings[present].1, points.last()));
            let steps = from.len() as f64;
            let turn = from.iter().enumerate().map(|(k, p)| {
                let (_, to) = nearest(&rings[next].1, p);
                p + (to - p) * ((k + 1) as f64 / steps)
            });
            let begin = points.len() - 1;
            points.extend(turn);
            // Rings on different sides of a hole do not pass into each other.
            let mut steps = points[begin..].windows(2);
            if !steps.all(|ends| polygon.sees(&ends[0], &ends[1], OVER_M)) {
                points.truncate(begin + 1);
                break;
            }
            used[next] = true;
            present = next;
        }
        if present != first {
            // The last ring is closed.
            points.extend(dense(&rotated(&rings[present].1, points.last())));
        }
        spirals.push(points);
    }
    spirals
}

fn distance_m(ring: &[Vector2<f64>], point: &Vector2<f64>) -> f64 {
    (nearest(ring, point).1 - point).norm()
}

/// Index of the edge of a closed ring that is nearest to `point`, and the place on it.
fn nearest(ring: &[Vector2<f64>], point: &Vector2<f64>) -> (usize, Vector2<f64>) {
    (ring.windows(2).enumerate())
        .map(|(i, ends)| (i, nearest_on(&ends[0], &ends[1], point)))
        .min_by(|a, b| (a.1 - point).norm().total_cmp(&(b.1 - point).norm()))
        .unwrap_or((0, *point))
}

/// A closed ring that begins and ends at its place nearest to `start`.
fn rotated(ring: &[Vector2<f64>], start: Option<&Vector2<f64>>) -> Points {
    let Some(start) = start else {
        return ring.to_vec();
    };
    let (edge, place) = nearest(ring, start);
    let count = ring.len() - 1;
    let mut points = vec![place];
    points.extend((1..=count).map(|k| ring[(edge + k) % count]));
    points.push(place);
    points
}

/// A line with additional points, so that none is further than [`SPIRAL_STEP_M`] from the next.
fn dense(line: &[Vector2<f64>]) -> Points {
    let mut points = vec![line[0]];
    for ends in line.windows(2) {
        let steps = ((ends[1] - ends[0]).norm() / SPIRAL_STEP_M).ceil().max(1.0) as usize;
        points
            .extend((1..=steps).map(|k| ends[0] + (ends[1] - ends[0]) * (k as f64 / steps as f64)));
    }
    points
}
