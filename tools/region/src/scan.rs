//! The points of a scan as heights over the plane of a task.
//!
//! Each node takes the median height of the points around it, and nodes that stand out take that of
//! their neighbours. Gaps of a few nodes are closed, the heights are smoothed, and the largest
//! connected part is kept.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::error::RegionError;
use crate::height_map::HeightMap;
use crate::isoline::Field;
use crate::mesh::{Mesh, bounds};
use crate::options::{RegionOptions, cell_m};
use crate::patch::unit;
use crate::plane::TaskPlane;

/// Gaps that are closed, nodes.
const CLOSED: usize = 3;
/// Rounds in which the heights are smoothed.
const SMOOTHED: usize = 3;
/// Largest step between neighbouring nodes of one surface, cells.
const STEP_CELLS: f64 = 3.0;

/// Heights of the points, all of which are in the region.
pub(crate) fn map(
    points: &Mesh,
    options: &RegionOptions<'_>,
    spacing_m: f64,
) -> Result<(HeightMap, Vec<String>), RegionError> {
    let mut notes = Vec::new();
    let normal = match options.approach {
        Some(approach) => -unit(&approach, "--approach")?,
        None => {
            notes.push(
                "the scan states no approach: it is taken from above, perpendicular to the points"
                    .to_owned(),
            );
            thinnest(&points.vertices)
        }
    };
    let along = unit(&options.rows_along, "--rows-along")?;
    let plane = TaskPlane::new(points.vertices[0], &normal, &along);
    let mut places: Vec<Vector3<f64>> = points.vertices.iter().map(|v| plane.place(v)).collect();
    if let Some(outline) = &options.outline_m {
        let ring: Vec<[f64; 2]> = (outline.iter())
            .map(|p| plane.place(&(*p).into()).xy().into())
            .collect();
        let polygon = tangent_control::fill::Polygon::new(&ring, &[]);
        let near = |p: &Vector3<f64>| {
            polygon.contains(&p.xy()) || polygon.edge_distance_m(&p.xy()) < spacing_m
        };
        places.retain(near);
    }
    if places.len() < 16 {
        return Err(RegionError::Nothing(format!(
            "{} points of the scan are there",
            places.len()
        )));
    }
    let (low, high) = bounds(places.iter().map(|p| p.xy()));
    let size = high - low;
    let apart_m = (size.x * size.y / places.len() as f64).sqrt();
    let cell_m = cell_m(size, spacing_m, apart_m)?;
    let mut map = HeightMap::empty(plane, low, high, cell_m);
    medians(&mut map, &places);
    despike(&mut map);
    close(&mut map);
    smooth(&mut map);
    keep_largest(&mut map);
    map.edges = edges(&map);
    Ok((map, notes))
}

/// Direction in which the points spread least, upwards in the base.
fn thinnest(points: &[Vector3<f64>]) -> Vector3<f64> {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let spread: Matrix3<f64> = points
        .iter()
        .map(|p| (p - mean) * (p - mean).transpose())
        .sum();
    let eigen = spread.symmetric_eigen();
    let (least, _) = eigen.eigenvalues.argmin();
    let normal: Vector3<f64> = eigen.eigenvectors.column(least).into_owned();
    if normal.z < 0.0 { -normal } else { normal }
}

fn medians(map: &mut HeightMap, places: &[Vector3<f64>]) {
    let mut of: Vec<(usize, f64)> = (places.iter())
        .filter_map(|p| Some((map.node(&p.xy())?, p.z)))
        .collect();
    of.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    for group in of.chunk_by(|a, b| a.0 == b.0) {
        map.heights_m[group[0].0] = group[group.len() / 2].1;
    }
}

/// Known nodes around one, within one step.
fn around(map: &HeightMap, node: usize) -> impl Iterator<Item = usize> + '_ {
    let (i, j) = ((node % map.columns) as i64, (node / map.columns) as i64);
    let near = (-1..=1).flat_map(|dj| (-1..=1).map(move |di| (di, dj)));
    near.filter(|step| *step != (0, 0))
        .filter_map(move |(di, dj)| {
            let (i, j) = (i + di, j + dj);
            let inside = i >= 0 && j >= 0 && i < map.columns as i64 && j < map.rows as i64;
            let other = j * map.columns as i64 + i;
            inside
                .then_some(other as usize)
                .filter(|other| map.heights_m[*other].is_finite())
        })
}

/// Gives nodes that stand out from the median of those around them that median.
fn despike(map: &mut HeightMap) {
    let medians: Vec<(usize, f64)> = (0..map.heights_m.len())
        .filter(|node| map.heights_m[*node].is_finite())
        .filter_map(|node| {
            let mut near: Vec<f64> = around(map, node).map(|k| map.heights_m[k]).collect();
            near.sort_by(f64::total_cmp);
            let median = *near.get(near.len() / 2)?;
            ((map.heights_m[node] - median).abs() > map.cell_m).then_some((node, median))
        })
        .collect();
    medians
        .into_iter()
        .for_each(|(node, h)| map.heights_m[node] = h);
}

/// Grows the known nodes into gaps, and takes back what grew beyond the rim.
fn close(map: &mut HeightMap) {
    let known: Vec<bool> = map.heights_m.iter().map(|h| h.is_finite()).collect();
    for _ in 0..CLOSED {
        let grown: Vec<(usize, f64)> = (0..known.len())
            .filter(|node| !map.heights_m[*node].is_finite())
            .filter_map(|node| {
                let (sum, count) = around(map, node).fold((0.0, 0), |(sum, count), other| {
                    (sum + map.heights_m[other], count + 1)
                });
                (count > 0).then(|| (node, sum / f64::from(count)))
            })
            .collect();
        grown
            .into_iter()
            .for_each(|(node, h)| map.heights_m[node] = h);
    }
    for _ in 0..CLOSED {
        let rim: Vec<usize> = (0..known.len())
            .filter(|node| !known[*node] && map.heights_m[*node].is_finite())
            .filter(|node| around(map, *node).count() < 8)
            .collect();
        rim.into_iter()
            .for_each(|node| map.heights_m[node] = f64::NAN);
    }
}

fn smooth(map: &mut HeightMap) {
    for _ in 0..SMOOTHED {
        map.heights_m = (0..map.heights_m.len())
            .map(|node| {
                let own = map.heights_m[node];
                // A plane through the node keeps its slope: opposite neighbours only.
                let pairs = [1, map.columns, map.columns + 1, map.columns - 1];
                let (mut sum, mut count) = (own, 1.0);
                for step in pairs {
                    let before = node
                        .checked_sub(step)
                        .map_or(f64::NAN, |k| map.heights_m[k]);
                    let after = map.heights_m.get(node + step).copied().unwrap_or(f64::NAN);
                    let flat = (before - after).abs() < 2.0 * STEP_CELLS * map.cell_m;
                    if before.is_finite() && after.is_finite() && flat {
                        sum += before + after;
                        count += 2.0;
                    }
                }
                sum / count
            })
            .collect();
    }
}

/// Marks the largest connected part as the region.
fn keep_largest(map: &mut HeightMap) {
    let mut seen = vec![false; map.heights_m.len()];
    let mut largest = Vec::new();
    let known: Vec<usize> = (0..seen.len())
        .filter(|k| map.heights_m[*k].is_finite())
        .collect();
    for first in known {
        if seen[first] {
            continue;
        }
        seen[first] = true;
        let mut part = vec![first];
        let mut done = 0;
        while let Some(&node) = part.get(done) {
            done += 1;
            let own = map.heights_m[node];
            for other in around(map, node) {
                let step = (map.heights_m[other] - own).abs();
                if !seen[other] && step < STEP_CELLS * map.cell_m {
                    seen[other] = true;
                    part.push(other);
                }
            }
        }
        if part.len() > largest.len() {
            largest = part;
        }
    }
    largest.iter().for_each(|node| map.inside[*node] = true);
    for node in 0..seen.len() {
        if !map.inside[node] {
            map.heights_m[node] = f64::NAN;
        }
    }
}

/// The rim of the region.
fn edges(map: &HeightMap) -> Vec<[Vector3<f64>; 2]> {
    let values: Vec<f64> = map.inside.iter().map(|i| f64::from(u8::from(*i))).collect();
    let field = Field {
        values: &values,
        columns: map.columns,
        low: map.low,
        cell_m: map.cell_m,
    };
    let over = |p: &Vector2<f64>| p.push(map.height_m(p).unwrap_or_default());
    (field.rings(0.5).iter())
        .flat_map(|ring| {
            ring.windows(2)
                .map(|e| [over(&e[0]), over(&e[1])])
                .collect::<Vec<_>>()
        })
        .collect()
}
