//! A polygon with holes in the path's plane: what is inside, how far the edge is, and the same
//! polygon with a margin.
//!
//! Offsets come from `i_overlay`. Called while a task is loaded; allocates.

use i_overlay::mesh::float::outline::offset::OutlineOffset;
use i_overlay::mesh::float::style::{LineJoin, OutlineStyle};
use nalgebra::{SVector, Vector2, Vector3};

/// Angle of one segment of a rounded corner, rad.
const ROUND_RAD: f64 = 0.12;
/// Points of an offset that are nearer than this are one point, m.
const SAME_M: f64 = 1e-5;
/// Where a part of a way that is outside is compared with the edge.
const OUTSIDE_SHARES: [f64; 9] = [0.5, 0.1, 0.9, 0.2, 0.8, 0.3, 0.7, 0.4, 0.6];

/// Closed rings. A point is inside if a ray from it crosses the rings an odd number of times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Polygon {
    /// Corners of each ring, m.
    pub rings: Vec<Vec<Vector2<f64>>>,
}

impl Polygon {
    /// From an outline and holes, m. A last point that repeats the first one is left out.
    pub fn new(outline_m: &[[f64; 2]], holes_m: &[Vec<[f64; 2]>]) -> Self {
        let ring = |points: &[[f64; 2]]| {
            let mut ring: Vec<Vector2<f64>> = points.iter().map(|p| Vector2::from(*p)).collect();
            ring.dedup_by(|a, b| (*a - *b).norm() < SAME_M);
            while ring.len() > 1 && (ring[0] - ring[ring.len() - 1]).norm() < SAME_M {
                ring.pop();
            }
            ring
        };
        let mut rings = vec![ring(outline_m)];
        rings.extend(holes_m.iter().map(|hole| ring(hole)));
        Self { rings }
    }

    /// The polygon without everything nearer to an edge than `margin_m`; empty if nothing is left.
    pub fn inset(&self, margin_m: f64) -> Self {
        if margin_m <= 0.0 {
            return self.clone();
        }
        let turned = |(index, ring): (usize, &Vec<Vector2<f64>>)| {
            // The outline runs counterclockwise, holes clockwise.
            let mut points: Vec<[f64; 2]> = ring.iter().map(|p| [p.x, p.y]).collect();
            if (area_m2(ring) > 0.0) != (index == 0) {
                points.reverse();
            }
            points
        };
        let shape: Vec<Vec<[f64; 2]>> = self.rings.iter().enumerate().map(turned).collect();
        let style = OutlineStyle::new(-margin_m).line_join(LineJoin::Round(ROUND_RAD));
        let shapes = shape.outline_as::<i64>(&style);
        let rings = shapes.into_iter().flatten().filter_map(|contour| {
            let ring = Self::new(&contour, &[]).rings.swap_remove(0);
            (ring.len() >= 3).then_some(ring)
        });
        Self {
            rings: rings.collect(),
        }
    }

    /// Parts of the line at `y` that are inside, from the least x on, m.
    pub fn chords(&self, y: f64) -> Vec<[Vector2<f64>; 2]> {
        let mut xs: Vec<f64> = self
            .edges()
            .filter(|(a, b)| (a.y > y) != (b.y > y))
            .map(|(a, b)| a.x + (y - a.y) / (b.y - a.y) * (b.x - a.x))
            .collect();
        xs.sort_by(f64::total_cmp);
        xs.chunks_exact(2)
            .map(|ends| [Vector2::new(ends[0], y), Vector2::new(ends[1], y)])
            .collect()
    }

    /// Whether nothing is inside.
    pub fn is_empty(&self) -> bool {
        self.rings.is_empty()
    }

    /// Edges of all rings.
    pub fn edges(&self) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + '_ {
        self.rings.iter().flat_map(|ring| {
            let next = ring.iter().cycle().skip(1);
            ring.iter().zip(next).map(|(a, b)| (*a, *b))
        })
    }

    /// The edges on a surface with these heights over the plane, in pieces of at most `step_m`.
    pub fn edges_over(
        &self,
        step_m: f64,
        height_m: impl Fn(&Vector2<f64>) -> f64,
    ) -> Vec<[Vector3<f64>; 2]> {
        let over = |p: Vector2<f64>| p.push(height_m(&p));
        let mut pieces = Vec::new();
        for (a, b) in self.edges() {
            let count = ((b - a).norm() / step_m).ceil().max(1.0) as usize;
            let at = |k: usize| over(a.lerp(&b, k as f64 / count as f64));
            pieces.extend((0..count).map(|k| [at(k), at(k + 1)]));
        }
        pieces
    }

    /// Whether `point` is inside.
    pub fn contains(&self, point: &Vector2<f64>) -> bool {
        self.edges()
            .filter(|(a, b)| {
                (a.y > point.y) != (b.y > point.y)
                    && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
            })
            .count()
            % 2
            == 1
    }

    /// Distance of `point` from the nearest edge, m.
    pub fn edge_distance_m(&self, point: &Vector2<f64>) -> f64 {
        let away =
            |(a, b): (Vector2<f64>, Vector2<f64>)| (nearest_on(&a, &b, point) - point).norm();
        self.edges().map(away).fold(f64::INFINITY, f64::min)
    }

    /// Whether the straight way between two points stays inside, or leaves by at most `over_m`.
    pub fn sees(&self, from: &Vector2<f64>, to: &Vector2<f64>, over_m: f64) -> bool {
        let way = to - from;
        // Shares of the way at which it crosses an edge.
        let mut cuts = vec![0.0, 1.0];
        cuts.extend(self.edges().filter_map(|(a, b)| {
            let edge = b - a;
            let across = way.perp(&edge);
            let (t, u) = (
                (a - from).perp(&edge) / across,
                (a - from).perp(&way) / across,
            );
            ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some(t)
        }));
        cuts.sort_by(f64::total_cmp);
        let at = |share: f64| from + way * share;
        cuts.windows(2).all(|ends| {
            let part = ends[1] - ends[0];
            part * way.norm() <= 0.5 * over_m
                || self.contains(&at(ends[0] + 0.5 * part))
                || OUTSIDE_SHARES.iter().all(|share| {
                    let point = at(ends[0] + share * part);
                    self.contains(&point) || self.edge_distance_m(&point) <= over_m
                })
        })
    }

    /// The polygon turned about the origin by `angle_rad`.
    pub fn turned(&self, angle_rad: f64) -> Self {
        let turn = nalgebra::Rotation2::new(angle_rad);
        let ring = |ring: &Vec<Vector2<f64>>| ring.iter().map(|p| turn * p).collect();
        Self {
            rings: self.rings.iter().map(ring).collect(),
        }
    }

    /// Smallest and largest coordinates, m.
    pub fn bounds(&self) -> (Vector2<f64>, Vector2<f64>) {
        let start = (
            Vector2::repeat(f64::INFINITY),
            Vector2::repeat(f64::NEG_INFINITY),
        );
        (self.rings.iter().flatten()).fold(start, |(low, high), p| (low.inf(p), high.sup(p)))
    }
}

/// Area of a ring, m²; positive if it runs counterclockwise.
pub fn area_m2(ring: &[Vector2<f64>]) -> f64 {
    let next = ring.iter().cycle().skip(1);
    0.5 * (ring.iter().zip(next)).map(|(a, b)| a.perp(b)).sum::<f64>()
}

/// Point of the segment from `a` to `b` that is nearest to `point`, in the plane or in space.
pub fn nearest_on<const D: usize>(
    a: &SVector<f64, D>,
    b: &SVector<f64, D>,
    point: &SVector<f64, D>,
) -> SVector<f64, D> {
    let along = b - a;
    let length2 = along.norm_squared();
    if length2 == 0.0 {
        return *a;
    }
    a + along * ((point - a).dot(&along) / length2).clamp(0.0, 1.0)
}

/// Distance of a place from the nearest of some segments, m.
pub(crate) fn nearest_in_space(segments: &[[Vector3<f64>; 2]], place: &Vector3<f64>) -> f64 {
    let away2 = |[a, b]: &[Vector3<f64>; 2]| (nearest_on(a, b, place) - place).norm_squared();
    segments
        .iter()
        .map(away2)
        .fold(f64::INFINITY, f64::min)
        .sqrt()
}

/// Whether two segments have a point in common.
pub(crate) fn cross(a: (Vector2<f64>, Vector2<f64>), b: (Vector2<f64>, Vector2<f64>)) -> bool {
    let side = |p: Vector2<f64>, q: Vector2<f64>, r: Vector2<f64>| (q - p).perp(&(r - p));
    let (d1, d2) = (side(b.0, b.1, a.0), side(b.0, b.1, a.1));
    let (d3, d4) = (side(a.0, a.1, b.0), side(a.0, a.1, b.1));
    if d1 * d2 < 0.0 && d3 * d4 < 0.0 {
        return true;
    }
    let touches = |d: f64, p: Vector2<f64>, s: (Vector2<f64>, Vector2<f64>)| {
        d == 0.0 && (nearest_on(&s.0, &s.1, &p) - p).norm() < 1e-12
    };
    touches(d1, a.0, b) || touches(d2, a.1, b) || touches(d3, b.0, a) || touches(d4, b.1, a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plate() -> Polygon {
        let hole = vec![[0.04, 0.04], [0.06, 0.04], [0.06, 0.06], [0.04, 0.06]];
        Polygon::new(&[[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]], &[hole])
    }

    #[test]
    fn a_margin_is_kept_from_the_outline_and_from_holes() {
        for margin_m in [0.001, 0.005, 0.015] {
            let inset = plate().inset(margin_m);
            assert_eq!(inset.rings.len(), 2);
            for point in inset.rings.iter().flatten() {
                let away = plate().edge_distance_m(point);
                // A rounded corner is a chain of chords.
                assert!((away / margin_m - 1.0).abs() < 0.01, "{margin_m}: {away}");
                assert!(plate().contains(point));
            }
        }
        // The outline's direction does not matter.
        let turned = Polygon::new(&[[0.0, 0.0], [0.0, 0.1], [0.1, 0.1], [0.1, 0.0]], &[]);
        assert_eq!(turned.inset(0.01).rings.len(), 1);
        assert!(turned.inset(0.051).is_empty());
    }

    #[test]
    fn a_hole_hides_what_is_behind_it() {
        let (left, right) = (Vector2::new(0.01, 0.05), Vector2::new(0.09, 0.05));
        assert!(!plate().sees(&left, &right, 1e-4));
        let below = Vector2::new(0.09, 0.01);
        assert!(plate().sees(&Vector2::new(0.01, 0.01), &below, 1e-4));
        assert!(!plate().contains(&Vector2::new(0.05, 0.05)));
        assert!(!plate().sees(&left, &Vector2::new(-0.01, 0.05), 1e-4));
    }
}
