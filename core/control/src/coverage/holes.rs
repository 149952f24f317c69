//! Connected areas of a region that have too little.

use nalgebra::Vector2;

use super::dose_grid::DoseGrid;
use super::rules::RoundRules;

/// What a search has found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Holes {
    /// Number of connected areas.
    pub count: u32,
    /// Area of the largest one, cm².
    pub largest_cm2: f64,
    /// Middle of the largest one in the path's plane, m.
    pub largest_m: Vector2<f64>,
}

/// Room for a search. Making it allocates; searching does not.
#[derive(Clone, Debug, Default)]
pub(super) struct HoleSearch {
    seen: Vec<bool>,
    /// Cells whose neighbours are still to be looked at, in the first places.
    open: Vec<usize>,
}

impl HoleSearch {
    /// For grids of at most this many cells.
    pub fn with_room(cells: usize) -> Self {
        Self {
            seen: vec![false; cells],
            open: vec![0; cells],
        }
    }

    /// Finds the connected components of the cells with too little.
    pub fn search(&mut self, grid: &DoseGrid, rules: &RoundRules) -> Holes {
        let mut holes = Holes::default();
        self.seen.fill(false);
        for first in 0..grid.cells.len() {
            if self.seen[first] || !grid.is_under(first, rules) {
                continue;
            }
            let (area_cm2, middle) = self.component(first, grid, rules);
            holes.count += 1;
            if area_cm2 > holes.largest_cm2 {
                holes.largest_cm2 = area_cm2;
                holes.largest_m = middle;
            }
        }
        holes
    }

    /// Area of the component of a cell, cm², and its middle, m.
    fn component(
        &mut self,
        first: usize,
        grid: &DoseGrid,
        rules: &RoundRules,
    ) -> (f64, Vector2<f64>) {
        let (mut area_cm2, mut moment) = (0.0, Vector2::zeros());
        self.seen[first] = true;
        self.open[0] = first;
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let index = self.open[count];
            let cell_cm2 = grid.cell_cm2(index);
            area_cm2 += cell_cm2;
            moment += grid.middle(index) * cell_cm2;
            let (i, j) = grid.place(index);
            for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if let Some(next) = grid.index(i + di, j + dj)
                    && !self.seen[next]
                    && grid.is_under(next, rules)
                {
                    self.seen[next] = true;
                    // Each cell is here once: there is room.
                    self.open[count] = next;
                    count += 1;
                }
            }
        }
        (area_cm2, moment / area_cm2)
    }
}
