//! What a task has felt of its surface: a place and a normal for points of the path's plane.
//!
//! The controller records it while the tool slides, and reads it where the tool is to land again
//! after a way above the surface. The cells are allocated while the task is loaded.

use nalgebra::{Vector2, Vector3};

use crate::task::path::Path;

/// Smallest edge of a cell, m.
const CELL_MIN_M: f64 = 0.004;
/// Most cells.
const CELLS_MAX: usize = 4096;
/// Distance between places of the path from which its extent is taken, m.
const SPACING_M: f64 = 0.005;
/// Border around the path, m.
const BORDER_M: f64 = 0.01;

/// A place that the tool has felt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Felt {
    /// Point of the path's plane, m.
    pub in_plane: Vector2<f64>,
    /// Tool's origin there, m; axes in which the surface is at rest.
    pub position: Vector3<f64>,
    /// Normal in use there, unit.
    pub normal: Vector3<f64>,
}

/// Places that the tool has felt, one a cell: the newest.
#[derive(Clone, Debug)]
pub struct SurfaceChart {
    low: Vector2<f64>,
    cell_m: f64,
    columns: usize,
    cells: Vec<Option<Felt>>,
}

impl SurfaceChart {
    /// An empty chart of the surface under a path. Allocates.
    pub fn new(path: &Path) -> Self {
        let places = path.places(SPACING_M);
        let start = (Vector2::zeros(), Vector2::zeros());
        let (low, high) = (places.iter()).fold(start, |(low, high), p| {
            (p.position.inf(&low), p.position.sup(&high))
        });
        let low = low - Vector2::repeat(BORDER_M);
        let size = high + Vector2::repeat(BORDER_M) - low;
        let mut cell_m = CELL_MIN_M;
        let count = |cell_m: f64| {
            let cells = |length: f64| (length / cell_m).ceil().max(1.0) as usize;
            (cells(size.x), cells(size.y))
        };
        while count(cell_m).0 * count(cell_m).1 > CELLS_MAX {
            cell_m *= 1.25;
        }
        let (columns, rows) = count(cell_m);
        Self {
            low,
            cell_m,
            columns,
            cells: vec![None; columns * rows],
        }
    }

    /// Records a place; without effect outside the chart.
    pub(crate) fn record(&mut self, felt: Felt) {
        let at = (felt.in_plane - self.low) / self.cell_m;
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < self.columns as f64;
        if !inside {
            return;
        }
        if let Some(cell) = (self.cells).get_mut(at.y as usize * self.columns + at.x as usize) {
            *cell = Some(felt);
        }
    }

    /// All felt places.
    pub(crate) fn felt(&self) -> impl Iterator<Item = &Felt> + '_ {
        self.cells.iter().flatten()
    }

    /// The felt place nearest to a point of the plane; `None` if none is within `far_m`.
    pub(crate) fn nearest(&self, in_plane: &Vector2<f64>, far_m: f64) -> Option<&Felt> {
        let away = |felt: &Felt| (felt.in_plane - in_plane).norm_squared();
        (self.cells.iter().flatten())
            .filter(|felt| away(felt) <= far_m * far_m)
            .min_by(|a, b| away(a).total_cmp(&away(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::path::PathSpec;

    #[test]
    fn the_nearest_place_is_found_and_places_outside_are_ignored() {
        let spec: PathSpec =
            toml::from_str("kind = \"line\"\nto_m = [1.0, 0.3]\nspeed_m_per_s = 0.05").unwrap();
        let mut chart = SurfaceChart::new(&Path::new(&spec, 0.1, 1.0).unwrap());
        assert!(chart.cells.len() <= CELLS_MAX);
        let felt = |x: f64, y: f64| Felt {
            in_plane: Vector2::new(x, y),
            position: Vector3::new(x, y, 0.1),
            normal: Vector3::z(),
        };
        for (x, y) in [
            (0.1, 0.1),
            (0.9, 0.2),
            (-5.0, 0.0),
            (0.5, 7.0),
            (0.5, f64::NAN),
        ] {
            chart.record(felt(x, y));
        }
        assert_eq!(chart.cells.iter().flatten().count(), 2);
        let near = Vector2::new(0.11, 0.1);
        assert_eq!(chart.nearest(&near, 0.02), Some(&felt(0.1, 0.1)));
        assert_eq!(chart.nearest(&near, 0.005), None);
    }
}
