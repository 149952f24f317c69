//! Expected shape of the surface under a path: heights over the path's plane, as a mesh or a scan
//! shows them.
//!
//! It is a guess. The law uses it where nothing is felt: on the way above the surface to the next
//! stroke, and for its area and its distances in the map of coverage. What is felt replaces it.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// Most heights.
const HEIGHTS_MAX: usize = 16_384;
/// Smallest and largest distance between heights, m.
const CELL_M: (f64, f64) = (0.0005, 0.1);
/// Steepest slope between neighbouring heights, m per m: 72 degrees.
const SLOPE_MAX: f64 = 3.1;
/// A path may leave the grid by this much, m.
const BORDER_M: f64 = 0.005;

/// Heights over the path's plane on a grid, for `path.surface` of a task file. The origin of the
/// plane is where the tool touches down; z is out of the material.
///
/// ```
/// use nalgebra::Vector2;
/// use tangent_control::ExpectedSurface;
///
/// let text = "corner_m = [0.0, 0.0]
///     cell_m = 0.1
///     columns = 2
///     heights_m = [0.0, 0.1, 0.0, 0.1]";
/// let slope: ExpectedSurface = toml::from_str(text)?;
/// assert!((slope.height_m(&Vector2::new(0.05, 0.03)) - 0.05).abs() < 1e-12);
/// assert!((slope.slope(&Vector2::new(0.05, 0.03)) - Vector2::new(1.0, 0.0)).norm() < 1e-9);
/// # Ok::<(), toml::de::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExpectedSurface {
    /// Place of the first height in the path's plane, m.
    pub corner_m: [f64; 2],
    /// Distance between neighbouring heights, m.
    pub cell_m: f64,
    /// Number of heights along x.
    pub columns: usize,
    /// Heights, m: rows along x, the row with the least y first.
    pub heights_m: Vec<f64>,
}

impl ExpectedSurface {
    /// Checks every number, and that all `points` (m) are on the grid.
    pub(crate) fn check<'a>(
        &self,
        points: impl Iterator<Item = &'a [f64; 2]>,
    ) -> Result<(), ControlError> {
        let key = |name: &str| format!("path.surface.{name}");
        check_range(&key("cell_m"), self.cell_m, CELL_M.0, CELL_M.1)?;
        for c in self.corner_m {
            check_range(&key("corner_m"), c, -2.0, 2.0)?;
        }
        let count = self.heights_m.len();
        if count > HEIGHTS_MAX {
            let allowed = format!("at most {HEIGHTS_MAX} heights");
            return Err(ControlError::range(key("heights_m"), count, &allowed));
        }
        if self.columns < 2 || self.rows() < 2 || !count.is_multiple_of(self.columns) {
            let value = format!("{} with {count} heights", self.columns);
            let allowed = "2 or more that divide the number of heights, in 2 rows or more";
            return Err(ControlError::range(key("columns"), value, allowed));
        }
        for height_m in &self.heights_m {
            check_range(&key("heights_m"), *height_m, -1.0, 1.0)?;
        }
        for index in 0..count {
            let (i, j) = (index % self.columns, index / self.columns);
            let beside = (i + 1 < self.columns).then(|| index + 1);
            let above = (j + 1 < self.rows()).then(|| index + self.columns);
            for next in [beside, above].into_iter().flatten() {
                let slope = (self.heights_m[next] - self.heights_m[index]) / self.cell_m;
                check_range(
                    &key("heights_m: slope, m per m"),
                    slope,
                    -SLOPE_MAX,
                    SLOPE_MAX,
                )?;
            }
        }
        let (low, high) = self.bounds();
        let outside =
            |p: &&[f64; 2]| (0..2).any(|k| p[k] < low[k] - BORDER_M || p[k] > high[k] + BORDER_M);
        let mut points = points;
        if let Some(point) = points.find(outside) {
            let allowed = format!(
                "points on the grid of `path.surface`: ({:.4}, {:.4}) to ({:.4}, {:.4}) m",
                low.x, low.y, high.x, high.y
            );
            let value = format!("({}, {})", point[0], point[1]);
            return Err(ControlError::range("path", value, &allowed));
        }
        Ok(())
    }

    /// Number of heights along y.
    pub fn rows(&self) -> usize {
        self.heights_m.len() / self.columns.max(1)
    }

    /// Places of the first and the last height, m.
    pub fn bounds(&self) -> (Vector2<f64>, Vector2<f64>) {
        let low = Vector2::from(self.corner_m);
        let steps = |count: usize| count.saturating_sub(1) as f64;
        let size = Vector2::new(steps(self.columns), steps(self.rows())) * self.cell_m;
        (low, low + size)
    }

    /// The four heights around a place, and its shares of the way between them.
    fn around(&self, at: &Vector2<f64>) -> ([f64; 4], Vector2<f64>) {
        let place = (at - Vector2::from(self.corner_m)) / self.cell_m;
        let along = |x: f64, count: usize| {
            let x = x.clamp(0.0, (count - 1) as f64);
            let i = (x.floor() as usize).min(count - 2);
            (i, x - i as f64)
        };
        let (i, u) = along(place.x, self.columns);
        let (j, v) = along(place.y, self.rows());
        let first = j * self.columns + i;
        let above = first + self.columns;
        let h = &self.heights_m;
        (
            [h[first], h[first + 1], h[above], h[above + 1]],
            Vector2::new(u, v),
        )
    }

    /// Height at a place of the path's plane, m; beyond the grid that of its edge.
    pub fn height_m(&self, at: &Vector2<f64>) -> f64 {
        let ([a, b, c, d], s) = self.around(at);
        (a * (1.0 - s.x) + b * s.x) * (1.0 - s.y) + (c * (1.0 - s.x) + d * s.x) * s.y
    }

    /// Slope at a place of the path's plane, m per m: over a cell on each side.
    pub fn slope(&self, at: &Vector2<f64>) -> Vector2<f64> {
        let (low, high) = self.bounds();
        let at = at.sup(&low).inf(&high);
        let along = |axis: Vector2<f64>| {
            let step = axis * self.cell_m;
            let (from, to) = ((at - step).sup(&low), (at + step).inf(&high));
            (self.height_m(&to) - self.height_m(&from)) / (to - from).norm()
        };
        Vector2::new(along(Vector2::x()), along(Vector2::y()))
    }
}

/// Unit normal of a surface with this slope over the plane; axes of the plane, z out of the
/// material.
pub(crate) fn normal_of(slope: &Vector2<f64>) -> Vector3<f64> {
    Vector3::new(-slope.x, -slope.y, 1.0).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bowl() -> ExpectedSurface {
        let height = |i: usize, j: usize| {
            let (x, y) = (0.01 * i as f64 - 0.05, 0.01 * j as f64 - 0.05);
            x * x + 2.0 * y * y
        };
        ExpectedSurface {
            corner_m: [-0.05, -0.05],
            cell_m: 0.01,
            columns: 11,
            heights_m: (0..121).map(|k| height(k % 11, k / 11)).collect(),
        }
    }

    #[test]
    fn heights_and_slopes_are_those_of_the_surface() {
        let bowl = bowl();
        bowl.check([[0.0, 0.0], [0.05, -0.05]].iter()).unwrap();
        for (x, y) in [(0.0, 0.0), (0.013, -0.027), (-0.048, 0.031)] {
            let at = Vector2::new(x, y);
            assert!((bowl.height_m(&at) - (x * x + 2.0 * y * y)).abs() < 1e-4);
            assert!((bowl.slope(&at) - Vector2::new(2.0 * x, 4.0 * y)).norm() < 0.03);
        }
        // Beyond the grid there is no more height.
        let far = Vector2::new(1.0, 0.0);
        assert_eq!(bowl.height_m(&far), bowl.height_m(&Vector2::new(0.05, 0.0)));
    }

    #[test]
    fn bad_grids_are_refused_by_key() {
        for (change, key) in [
            (
                (|s| s.cell_m = f64::NAN) as fn(&mut ExpectedSurface),
                "surface.cell_m",
            ),
            (|s| s.columns = 10, "surface.columns"),
            (|s| s.columns = 0, "surface.columns"),
            (|s| s.heights_m[7] = f64::INFINITY, "surface.heights_m"),
            (|s| s.heights_m[7] = 0.5, "slope"),
            (|s| s.heights_m = vec![0.0; 20_000], "16384"),
            (|s| s.corner_m[0] = 0.01, "points on the grid"),
        ] {
            let mut surface = bowl();
            change(&mut surface);
            let error = surface.check([[0.0, 0.0]].iter()).unwrap_err().to_string();
            assert!(error.contains(key), "{key}: {error}");
        }
    }
}
