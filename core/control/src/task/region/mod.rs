//! A region of the surface, drawn as a polygon with holes, and the strokes that fill it.
//!
//! Called while a task is loaded; allocates.

pub(crate) mod order;
mod pattern;
pub(crate) mod polygon;
mod simplify;

/// Polygons, patterns and their order, for tools that draw or fill regions of their own.
pub mod fill {
    pub use super::order::{Ordered, Points, ordered};
    pub use super::pattern::{Ring, spiral_of};
    pub use super::polygon::{Polygon, area_m2, nearest_on};
    pub use super::simplify::simplify;
}

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};
use crate::task::path::ranges::{
    LIFT_M, PAUSE_S, SPEED_M_PER_S, check_point, default_lift, default_travel,
};
use order::{Ordered, ordered};
use polygon::{Polygon, cross};

/// Most corners of an outline and its holes.
const CORNERS_MAX: usize = 2000;
/// Most strokes of a region.
const STROKES_MAX: usize = 2000;
/// Smallest and largest distance between strokes, m.
const SPACING_M: (f64, f64) = (0.0005, 0.5);
/// Share of the spacing by which the way between two strokes may leave the region less its margin.
const OVER_SHARE: f64 = 0.1;

/// A region: a polygon with holes in the path's plane, filled with strokes. Lengths are along the
/// surface, from the place where the tool touches down.
///
/// ```
/// use tangent_control::{Path, PathSpec};
///
/// let text = "kind = 'region'
///     outline_m = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.06], [0.0, 0.06]]
///     holes_m = [[[0.04, 0.02], [0.06, 0.02], [0.06, 0.04], [0.04, 0.04]]]
///     spacing_m = 0.01
///     margin_m = 0.002
///     speed_m_per_s = 0.03";
/// let region: PathSpec = toml::from_str(text)?;
/// let path = Path::new(&region, 0.1, 1.0)?;
/// // The hole is passed above the surface once at most on each side.
/// assert!(path.lifts() <= 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Corners of the outline, m.
    pub outline_m: Vec<[f64; 2]>,
    /// Corners of each hole, m.
    #[serde(default)]
    pub holes_m: Vec<Vec<[f64; 2]>>,
    /// Pattern of the strokes.
    #[serde(default)]
    pub pattern: Pattern,
    /// Largest distance between strokes, m.
    pub spacing_m: f64,
    /// Angle of the rows of a raster to the x axis, rad.
    #[serde(default)]
    pub angle_rad: f64,
    /// Distance of the tool's middle from every edge, m.
    #[serde(default)]
    pub margin_m: f64,
    /// Speed, m/s.
    pub speed_m_per_s: f64,
    /// Pause at every sharp corner and at the end of every stroke, s.
    #[serde(default)]
    pub pause_s: f64,
    /// Height above the surface between strokes, m.
    #[serde(default = "default_lift")]
    pub lift_m: f64,
    /// Speed above the surface, m/s.
    #[serde(default = "default_travel")]
    pub travel_speed_m_per_s: f64,
}

/// Pattern of the strokes in a region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pattern {
    /// Parallel rows, back and forth.
    #[default]
    Raster,
    /// Rings along the edges that pass into each other.
    Spiral,
    /// Rings along the edges.
    Contour,
}

impl Region {
    /// Checks every number, the shape, and that strokes are left.
    pub(crate) fn check(&self) -> Result<(), ControlError> {
        self.plan().map(drop)
    }

    /// The polygon of the region.
    pub(crate) fn polygon(&self) -> Polygon {
        Polygon::new(&self.outline_m, &self.holes_m)
    }

    /// Where the tool's middle may be.
    pub(crate) fn within_margin(&self) -> Polygon {
        self.polygon().inset(self.margin_m)
    }

    /// The strokes in their order, from the origin.
    pub(crate) fn plan(&self) -> Result<Vec<Ordered>, ControlError> {
        self.check_numbers()?;
        self.check_shape("path")?;
        let polygon = self.within_margin();
        if polygon.is_empty() {
            return Err(ControlError::range(
                "path.margin_m",
                self.margin_m,
                "a distance from the edges that leaves a part of the region",
            ));
        }
        let (low, high) = polygon.bounds();
        let rows = (high - low).norm() / self.spacing_m;
        if rows > STROKES_MAX as f64 {
            return Err(self.too_many(&format!("{rows:.0} rows")));
        }
        let strokes = match self.pattern {
            Pattern::Raster => pattern::raster(&polygon, self.spacing_m, self.angle_rad),
            Pattern::Spiral => pattern::spiral(&polygon, self.spacing_m),
            Pattern::Contour => pattern::contour(&polygon, self.spacing_m),
        };
        if strokes.len() > STROKES_MAX {
            return Err(self.too_many(&format!("{} strokes", strokes.len())));
        }
        let over_m = (OVER_SHARE * self.spacing_m).max(1e-4);
        Ok(ordered(strokes, Vector2::zeros(), &polygon, over_m))
    }

    fn too_many(&self, count: &str) -> ControlError {
        ControlError::range(
            "path.spacing_m",
            format!("{} ({count})", self.spacing_m),
            &format!("a spacing that gives at most {STROKES_MAX} strokes"),
        )
    }

    fn check_numbers(&self) -> Result<(), ControlError> {
        check_range("path.spacing_m", self.spacing_m, SPACING_M.0, SPACING_M.1)?;
        check_range("path.angle_rad", self.angle_rad, -6.3, 6.3)?;
        if self.angle_rad != 0.0 && self.pattern != Pattern::Raster {
            let allowed = "an angle only with `pattern = \"raster\"`";
            return Err(ControlError::range(
                "path.angle_rad",
                self.angle_rad,
                allowed,
            ));
        }
        check_range("path.margin_m", self.margin_m, 0.0, 0.5)?;
        check_range("path.pause_s", self.pause_s, PAUSE_S.0, PAUSE_S.1)?;
        check_range("path.lift_m", self.lift_m, LIFT_M.0, LIFT_M.1)?;
        let speed = |key, v| check_range(key, v, SPEED_M_PER_S.0, SPEED_M_PER_S.1);
        speed("path.travel_speed_m_per_s", self.travel_speed_m_per_s)?;
        speed("path.speed_m_per_s", self.speed_m_per_s)
    }

    /// Checks the corners, and that no edge meets another one; `table` is that of the keys.
    pub(crate) fn check_shape(&self, table: &str) -> Result<(), ControlError> {
        let key = |hole: Option<usize>| match hole {
            None => format!("{table}.outline_m"),
            Some(hole) => format!("{table}.holes_m[{hole}]"),
        };
        let holes = self
            .holes_m
            .iter()
            .enumerate()
            .map(|(i, hole)| (Some(i), hole));
        for (hole, corners) in std::iter::once((None, &self.outline_m)).chain(holes) {
            for point in corners {
                check_point(&key(hole), point)?;
            }
        }
        let polygon = self.polygon();
        let name = |ring: usize| key(ring.checked_sub(1));
        let corners: usize = polygon.rings.iter().map(Vec::len).sum();
        if corners > CORNERS_MAX {
            let allowed = format!("at most {CORNERS_MAX} points with all holes");
            return Err(ControlError::range(
                name(0),
                format!("{corners} points"),
                &allowed,
            ));
        }
        for (ring, points) in polygon.rings.iter().enumerate() {
            if points.len() < 3 {
                let value = format!("{} different points", points.len());
                return Err(ControlError::range(name(ring), value, "3 points or more"));
            }
        }
        let edges: Vec<_> = (polygon.rings.iter().enumerate())
            .flat_map(|(ring, points)| {
                let n = points.len();
                (0..n).map(move |i| (ring, i, (points[i], points[(i + 1) % n])))
            })
            .collect();
        for (k, a) in edges.iter().enumerate() {
            for b in &edges[k + 1..] {
                let n = polygon.rings[a.0].len();
                let follow = a.0 == b.0 && (b.1 == a.1 + 1 || a.1 == 0 && b.1 == n - 1);
                // Edges that follow each other meet in a corner; they must not fold back.
                let meet = if follow {
                    n == 2 || folds_back(a.2, b.2)
                } else {
                    cross(a.2, b.2)
                };
                if meet {
                    let value = format!("edge {} meets edge {} of {}", a.1 + 1, b.1 + 1, name(b.0));
                    let allowed = "edges that do not meet but in common corners";
                    return Err(ControlError::range(name(a.0), value, allowed));
                }
            }
        }
        for (hole, points) in polygon.rings.iter().enumerate().skip(1) {
            let around = |ring: usize| {
                let rings = vec![polygon.rings[ring].clone()];
                Polygon { rings }.contains(&points[0])
            };
            if !around(0) {
                let value = format!("a hole at ({}, {}) m", points[0].x, points[0].y);
                return Err(ControlError::range(
                    name(hole),
                    value,
                    "a hole inside the outline",
                ));
            }
            if let Some(other) = (1..polygon.rings.len()).find(|&o| o != hole && around(o)) {
                let value = format!("a hole in {}", name(other));
                return Err(ControlError::range(
                    name(hole),
                    value,
                    "a hole outside other holes",
                ));
            }
        }
        Ok(())
    }
}

/// Whether two edges with a common corner run back along each other.
fn folds_back(a: (Vector2<f64>, Vector2<f64>), b: (Vector2<f64>, Vector2<f64>)) -> bool {
    let (corner, from, to) = if a.1 == b.0 {
        (a.1, a.0, b.1)
    } else {
        (a.0, a.1, b.0)
    };
    let (u, v) = (from - corner, to - corner);
    u.perp(&v).abs() < 1e-9 * u.norm() * v.norm() && u.dot(&v) > 0.0
}

#[cfg(test)]
mod tests;
