//! Strokes that fill a region, with distances along the surface.

use nalgebra::Vector2;
use tangent_control::Pattern;
use tangent_control::fill::{
    Ordered, Points, Polygon, Ring, area_m2, ordered, simplify, spiral_of,
};

use crate::edge_distance::edge_distance;
use crate::error::RegionError;
use crate::height_map::HeightMap;
use crate::isoline::Field;
use crate::rows::rows;

/// Least number of nodes between strokes.
pub(crate) const NODES_PER_SPACING: f64 = 5.0;
/// Most strokes.
const STROKES_MAX: usize = 2000;
/// Level just inside the edge, m.
const EDGE_M: f64 = 1e-6;
/// Largest distance of a stroke from the exact line, m.
const TOLERANCE_M: f64 = 1e-4;
/// Shortest stroke, as a share of the spacing.
const SHORT_SHARE: f64 = 0.1;
/// Share of the spacing beyond which what the last ring surrounds gets one more ring.
const CORE_SHARE: f64 = 0.5;
/// Share of the spacing by which the way between two strokes may leave the region less its margin.
const OVER_SHARE: f64 = 0.1;

/// How a region is filled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fill {
    /// Pattern of the strokes.
    pub pattern: Pattern,
    /// Largest distance between strokes along the surface, m.
    pub spacing_m: f64,
    /// Distance of the strokes from every edge along the surface, m.
    pub margin_m: f64,
    /// Whether a raster has one more stroke along every edge, before its rows.
    pub edge_pass: bool,
}

/// A stroke of a filled region.
#[derive(Clone, Debug, PartialEq)]
pub struct FillStroke {
    /// Points, m.
    pub points: Points,
    /// Whether it runs along an edge of the region.
    pub at_edge: bool,
}

/// Strokes over the plane, not in an order yet, and the edges that they keep.
#[derive(Clone, Debug)]
pub struct Filled {
    /// Strokes.
    pub strokes: Vec<FillStroke>,
    /// Edge of the region: the outline first, then holes, m.
    pub edge: Polygon,
    /// Edge of the region less its margin.
    within: Polygon,
    /// By how much a way between two strokes may leave that, m.
    over_m: f64,
}

impl Filled {
    /// The strokes in an order that begins near `start` (m).
    pub fn ordered(&self, start: Vector2<f64>) -> Vec<FillStroke> {
        let points = self.strokes.iter().map(|s| s.points.clone()).collect();
        ordered(points, start, &self.within, self.over_m)
            .into_iter()
            .map(|Ordered { points, given, .. }| FillStroke {
                points,
                at_edge: self.strokes[given].at_edge,
            })
            .collect()
    }
}

/// Fills a region.
///
/// # Errors
/// Nothing is left inside the margin, or there are too many strokes.
pub fn fill(map: &HeightMap, fill: &Fill) -> Result<Filled, RegionError> {
    let distance = edge_distance(map);
    let whole = field(map, &distance);
    let at_edge = whole.rings(EDGE_M);
    let at_margin = whole.rings(fill.margin_m.max(EDGE_M));
    if at_margin.is_empty() {
        return Err(RegionError::Margin {
            margin_m: fill.margin_m,
        });
    }
    let within = polygon(&at_margin);
    let rings = || rings(map, &distance, fill);
    let strokes: Vec<(Points, bool)> = match fill.pattern {
        Pattern::Raster => {
            let edges = at_margin.into_iter().filter(|_| fill.edge_pass);
            let rows = rows(map, &within, fill.spacing_m).into_iter();
            (edges.map(|ring| (ring, true)))
                .chain(rows.map(|row| (row, false)))
                .collect()
        }
        Pattern::Contour => (rings().into_iter())
            .map(|(number, ring)| (ring, number == 0))
            .collect(),
        Pattern::Spiral => (spiral_of(&rings(), &within, fill.spacing_m).into_iter())
            .map(|stroke| (stroke, false))
            .collect(),
    };
    let short_m = SHORT_SHARE * fill.spacing_m;
    let strokes: Vec<FillStroke> = (strokes.into_iter())
        .filter(|(stroke, _)| length_m(stroke) > short_m)
        .map(|(stroke, at_edge)| FillStroke {
            points: simplify(&stroke, TOLERANCE_M),
            at_edge,
        })
        .collect();
    if strokes.len() > STROKES_MAX {
        return Err(RegionError::option(
            "--spacing-m",
            format!("{} ({} strokes)", fill.spacing_m, strokes.len()),
            format!("a spacing that gives at most {STROKES_MAX} strokes"),
        ));
    }
    if strokes.is_empty() {
        return Err(RegionError::Margin {
            margin_m: fill.margin_m,
        });
    }
    Ok(Filled {
        strokes,
        edge: polygon(&at_edge),
        within,
        over_m: (OVER_SHARE * fill.spacing_m).max(TOLERANCE_M),
    })
}

fn field<'a>(map: &HeightMap, values: &'a [f64]) -> Field<'a> {
    Field {
        values,
        columns: map.columns,
        low: map.low,
        cell_m: map.cell_m,
    }
}

/// Rings at the margin and every spacing further in; with the number of each.
fn rings(map: &HeightMap, distance: &[f64], fill: &Fill) -> Vec<Ring> {
    let mut found = Vec::new();
    for number in 0..STROKES_MAX {
        let level = fill.margin_m.max(EDGE_M) + number as f64 * fill.spacing_m;
        let rings = field(map, distance).rings(level);
        if rings.is_empty() {
            break;
        }
        found.extend(rings.into_iter().map(|ring| (number, ring)));
        // What these rings surround and the next ones do not reach may be wider than a row.
        let core = level + CORE_SHARE * fill.spacing_m;
        let only = cores(map, distance, core, level + fill.spacing_m);
        found.extend((field(map, &only).rings(core).into_iter()).map(|ring| (number + 1, ring)));
    }
    found
}

/// The distances, with zero in every connected part of what is above `core` that reaches `next`.
fn cores(map: &HeightMap, distance: &[f64], core: f64, next: f64) -> Vec<f64> {
    let mut only = distance.to_vec();
    let mut seen = vec![false; only.len()];
    for (first, own) in distance.iter().enumerate() {
        if seen[first] || *own < core {
            continue;
        }
        let mut part = vec![first];
        seen[first] = true;
        let (mut done, mut most) = (0, 0.0_f64);
        while let Some(&node) = part.get(done) {
            done += 1;
            most = most.max(distance[node]);
            let beside = [node + 1, node - 1, node + map.columns, node - map.columns];
            for other in beside {
                if distance[other] >= core && !std::mem::replace(&mut seen[other], true) {
                    part.push(other);
                }
            }
        }
        if most >= next {
            part.iter().for_each(|node| only[*node] = 0.0);
        }
    }
    only
}

/// Rings without their repeated points, the largest first.
fn polygon(rings: &[Points]) -> Polygon {
    let mut rings: Vec<Points> = (rings.iter())
        .map(|ring| {
            let mut ring = simplify(ring, TOLERANCE_M);
            ring.pop();
            ring
        })
        .filter(|ring| ring.len() >= 3)
        .collect();
    rings.sort_by(|a, b| area_m2(b).abs().total_cmp(&area_m2(a).abs()));
    Polygon { rings }
}

pub(crate) fn length_m(line: &[Vector2<f64>]) -> f64 {
    line.windows(2).map(|e| (e[1] - e[0]).norm()).sum()
}
