//! Grid of a region with the dose of pressure in each cell.
//!
//! The force is spread evenly over a disk of the tip's radius, as in the map that viewers show. The
//! rows of the grid are parallel to the rows of a raster. Coordinates are those of the path's
//! plane: lengths along the surface, or places over the plane if the task has an expected surface.
//! Distances and areas are then those of the expected surface.

use nalgebra::{Rotation2, Vector2};

use super::rules::RoundRules;
use crate::error::ControlError;
use crate::task::expected_surface::ExpectedSurface;
use crate::task::region::Region;
use crate::task::region::polygon::nearest_in_space;

/// Cells across the radius of the tip.
const CELLS_PER_RADIUS: f64 = 5.0;
/// Least cells across the radius.
const CELLS_PER_RADIUS_MIN: f64 = 2.5;
/// Most cells.
const CELLS_MAX: usize = 16_384;
/// A place is passed where the tip's middle is nearer than this share of its radius.
const PASS_SHARE: f64 = 0.8;
/// A tip that comes back after this time passes again, s.
const PASS_GAP_S: f64 = 0.5;
/// A cell is reached from a stroke within this share of the radius.
pub(super) const REACH_SHARE: f64 = 0.8;

/// Distance between places of an edge that are taken from the expected surface, m.
const EDGE_STEP_M: f64 = 0.004;

/// A cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cell {
    /// Whether the cell belongs to the region.
    pub judged: bool,
    /// Whether the tool's middle may be there.
    pub allowed: bool,
    /// Whether a stroke of the next round covers it.
    pub planned: bool,
    /// Index of the nearest place from which a stroke covers the cell; `None` if there is none.
    pub reached_from: Option<u32>,
    /// Time integral of the force, N*s.
    pub impulse_n_s: f64,
    /// Number of passes.
    pub passes: u32,
    /// Time at which the tip was last here, s.
    last_s: f64,
    /// Expected height over the plane, m.
    height_m: f64,
    /// Area of the expected surface over the cell's area.
    stretch: f64,
}

/// The grid. Its cells are allocated once.
#[derive(Clone, Debug)]
pub(super) struct DoseGrid {
    pub cells: Vec<Cell>,
    pub columns: usize,
    pub rows: usize,
    pub cell_m: f64,
    /// Least width of the tip's disk in the path's plane, from its middle, m.
    pub across_m: f64,
    radius_m: f64,
    low: Vector2<f64>,
    turn: Rotation2<f64>,
}

/// Areas of the region, cm².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Areas {
    pub good: f64,
    pub under: f64,
    pub over: f64,
}

impl Areas {
    /// Share of the region that is within the band.
    pub fn share(&self) -> f64 {
        self.good / (self.good + self.under + self.over).max(f64::MIN_POSITIVE)
    }
}

/// Greatest length along the expected surface per length in the plane, within a region.
fn steepest(region: &Region, expected: Option<&ExpectedSurface>) -> f64 {
    let Some(expected) = expected else {
        return 1.0;
    };
    let polygon = region.polygon();
    let low = Vector2::from(expected.corner_m);
    let places = (0..expected.heights_m.len()).map(|index| {
        let (i, j) = (index % expected.columns, index / expected.columns);
        low + Vector2::new(i as f64, j as f64) * expected.cell_m
    });
    (places.filter(|place| polygon.contains(place)))
        .map(|place| expected.slope(&place).norm().hypot(1.0))
        .fold(1.0, f64::max)
}

impl DoseGrid {
    /// An empty grid of a region. Allocates.
    pub fn new(
        region: &Region,
        expected: Option<&ExpectedSurface>,
        radius_m: f64,
        key: &str,
    ) -> Result<Self, ControlError> {
        let (polygon, within) = (
            region.polygon().turned(-region.angle_rad),
            region.within_margin().turned(-region.angle_rad),
        );
        let (low, high) = polygon.bounds();
        let across_m = radius_m / steepest(region, expected);
        let mut cell_m = across_m / CELLS_PER_RADIUS;
        let count = |cell_m: f64| {
            let along = |length: f64| (length / cell_m).ceil().max(1.0) as usize;
            (along(high.x - low.x), along(high.y - low.y))
        };
        while count(cell_m).0.saturating_mul(count(cell_m).1) > CELLS_MAX {
            cell_m *= 1.1;
        }
        if cell_m * CELLS_PER_RADIUS_MIN > across_m {
            let size = high - low;
            return Err(ControlError::range(
                format!("{key}.outline_m"),
                format!("{:.3} m by {:.3} m", size.x, size.y),
                &format!(
                    "with `coverage.radius_m` = {radius_m}, an area of at most {:.3} m²",
                    CELLS_MAX as f64 * (across_m / CELLS_PER_RADIUS_MIN).powi(2)
                ),
            ));
        }
        let (columns, rows) = count(cell_m);
        let mut grid = Self {
            cells: vec![Cell::default(); columns * rows],
            columns,
            rows,
            cell_m,
            across_m,
            radius_m,
            low,
            turn: Rotation2::new(region.angle_rad),
        };
        for index in 0..grid.cells.len() {
            let middle = grid.turned_middle(index);
            grid.cells[index].judged = polygon.contains(&middle);
            grid.cells[index].allowed = within.contains(&middle);
            grid.cells[index].last_s = f64::NEG_INFINITY;
            grid.cells[index].stretch = 1.0;
        }
        if let Some(expected) = expected {
            grid.expect(expected, region);
        }
        for index in 0..grid.cells.len() {
            grid.cells[index].reached_from = grid.nearest_allowed(index);
        }
        Ok(grid)
    }

    /// Takes heights, areas and the distances from the edges from the expected surface.
    fn expect(&mut self, expected: &ExpectedSurface, region: &Region) {
        let polygon = region.polygon();
        let edges = polygon.edges_over(EDGE_STEP_M, |p| expected.height_m(p));
        for index in 0..self.cells.len() {
            let middle = self.middle(index);
            let cell = &mut self.cells[index];
            cell.height_m = expected.height_m(&middle);
            cell.stretch = expected.slope(&middle).norm().hypot(1.0);
            if cell.judged {
                let place = middle.push(cell.height_m);
                let away_m = nearest_in_space(&edges, &place);
                cell.allowed = away_m >= region.margin_m;
            }
        }
    }

    fn nearest_allowed(&self, index: usize) -> Option<u32> {
        let far = (REACH_SHARE * self.radius_m / self.cell_m).floor() as i64;
        // Whole cells, in the plane and on a slope.
        let far_m = far as f64 * self.cell_m * (1.0 + 1e-9);
        let (i, j) = self.place(index);
        let away_m = |di: i64, dj: i64, other: usize| {
            let flat = Vector2::new(di as f64, dj as f64).norm() * self.cell_m;
            flat.hypot(self.cells[other].height_m - self.cells[index].height_m)
        };
        (-far..=far)
            .flat_map(|dj| (-far..=far).map(move |di| (di, dj)))
            .filter_map(|(di, dj)| {
                let other = self.index(i + di, j + dj)?;
                Some((away_m(di, dj, other), other))
            })
            .filter(|(away_m, other)| *away_m <= far_m && self.cells[*other].allowed)
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            .map(|(_, other)| other as u32)
    }

    /// Column and row of a cell.
    pub fn place(&self, index: usize) -> (i64, i64) {
        ((index % self.columns) as i64, (index / self.columns) as i64)
    }

    /// Index of the cell in a column and row; `None` outside the grid.
    pub fn index(&self, i: i64, j: i64) -> Option<usize> {
        let inside = i >= 0 && j >= 0 && i < self.columns as i64 && j < self.rows as i64;
        inside.then(|| j as usize * self.columns + i as usize)
    }

    fn turned_middle(&self, index: usize) -> Vector2<f64> {
        let (i, j) = self.place(index);
        self.low + Vector2::new(i as f64 + 0.5, j as f64 + 0.5) * self.cell_m
    }

    /// Middle of a cell in the path's plane, m.
    pub fn middle(&self, index: usize) -> Vector2<f64> {
        self.turn * self.turned_middle(index)
    }

    /// Column and row of a point of the path's plane, which may be outside the grid.
    pub fn place_of(&self, point: &Vector2<f64>) -> (i64, i64) {
        let at = (self.turn.inverse() * point - self.low) / self.cell_m;
        (at.x.floor() as i64, at.y.floor() as i64)
    }

    /// Area of the surface in a cell, cm².
    pub fn cell_cm2(&self, index: usize) -> f64 {
        self.cell_m * self.cell_m * 1e4 * self.cells[index].stretch
    }

    /// Dose in a cell, N*s/cm².
    pub fn dose(&self, index: usize) -> f64 {
        self.cells[index].impulse_n_s / self.cell_cm2(index)
    }

    /// Adds the force of `dt_s` seconds at a point of the path's plane, on a surface of this slope
    /// over it.
    pub fn press(
        &mut self,
        at: &Vector2<f64>,
        slope: &Vector2<f64>,
        force_n: f64,
        time_s: f64,
        dt_s: f64,
    ) {
        let slope = self.turn.inverse() * slope;
        let at = (self.turn.inverse() * at - self.low) / self.cell_m;
        if !(at.norm() < 1e6 && force_n > 0.0) {
            return;
        }
        let r = self.radius_m / self.cell_m;
        let (i0, i1) = ((at.x - r).floor() as i64, (at.x + r).floor() as i64);
        let (j0, j1) = ((at.y - r).floor() as i64, (at.y + r).floor() as i64);
        let away = |i: i64, j: i64| {
            let flat = Vector2::new(i as f64 + 0.5, j as f64 + 0.5) - at;
            flat.norm().hypot(slope.dot(&flat))
        };
        // A cell on the rim has a part of the force.
        let weight = |i: i64, j: i64| (r - away(i, j) + 0.5).clamp(0.0, 1.0);
        let mut sum = 0.0;
        for j in j0..=j1 {
            for i in i0..=i1 {
                sum += weight(i, j);
            }
        }
        for j in j0..=j1 {
            for i in i0..=i1 {
                let Some(index) = self.index(i, j) else {
                    continue;
                };
                let cell = &mut self.cells[index];
                cell.impulse_n_s += force_n * dt_s * weight(i, j) / sum;
                if away(i, j) < PASS_SHARE * r {
                    cell.passes += u32::from(time_s - cell.last_s > PASS_GAP_S);
                    cell.last_s = time_s;
                }
            }
        }
    }

    /// Whether a cell of the region has too little.
    pub fn is_under(&self, index: usize, rules: &RoundRules) -> bool {
        let cell = &self.cells[index];
        cell.judged
            && match rules.band {
                Some([least, _]) => self.dose(index) < least,
                None => cell.passes < rules.passes,
            }
    }

    /// Whether a cell of the region has too much.
    pub fn is_over(&self, index: usize, rules: &RoundRules) -> bool {
        let most = rules.band.map_or(f64::INFINITY, |[_, most]| most);
        self.cells[index].judged && self.dose(index) > most
    }

    /// Compares all cells with the band.
    pub fn judge(&self, rules: &RoundRules) -> Areas {
        let mut areas = Areas::default();
        for index in 0..self.cells.len() {
            let cell_cm2 = self.cell_cm2(index);
            if self.is_under(index, rules) {
                areas.under += cell_cm2;
            } else if self.is_over(index, rules) {
                areas.over += cell_cm2;
            } else if self.cells[index].judged {
                areas.good += cell_cm2;
            }
        }
        areas
    }
}
