//! Grid of a region with the dose of pressure in each cell.
//!
//! The force is spread evenly over a disk of the tip's radius, as in the map that viewers show. The
//! rows of the grid are parallel to the rows of a raster. Coordinates are those of the path's
//! plane: lengths along the surface.

use nalgebra::{Rotation2, Vector2};

use super::rules::RoundRules;
use crate::error::ControlError;
use crate::task::region::Region;

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
}

/// The grid. Its cells are allocated once.
#[derive(Clone, Debug)]
pub(super) struct DoseGrid {
    pub cells: Vec<Cell>,
    pub columns: usize,
    pub rows: usize,
    pub cell_m: f64,
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

impl DoseGrid {
    /// An empty grid of a region. Allocates.
    pub fn new(region: &Region, radius_m: f64) -> Result<Self, ControlError> {
        let (polygon, within) = (
            region.polygon().turned(-region.angle_rad),
            region.within_margin().turned(-region.angle_rad),
        );
        let (low, high) = polygon.bounds();
        let mut cell_m = radius_m / CELLS_PER_RADIUS;
        let count = |cell_m: f64| {
            let along = |length: f64| (length / cell_m).ceil().max(1.0) as usize;
            (along(high.x - low.x), along(high.y - low.y))
        };
        while count(cell_m).0.saturating_mul(count(cell_m).1) > CELLS_MAX {
            cell_m *= 1.1;
        }
        if cell_m * CELLS_PER_RADIUS_MIN > radius_m {
            let size = high - low;
            return Err(ControlError::range(
                "path.outline_m",
                format!("{:.3} m by {:.3} m", size.x, size.y),
                &format!(
                    "with `coverage.radius_m` = {radius_m}, an area of at most {:.3} m²",
                    CELLS_MAX as f64 * (radius_m / CELLS_PER_RADIUS_MIN).powi(2)
                ),
            ));
        }
        let (columns, rows) = count(cell_m);
        let mut grid = Self {
            cells: vec![Cell::default(); columns * rows],
            columns,
            rows,
            cell_m,
            radius_m,
            low,
            turn: Rotation2::new(region.angle_rad),
        };
        for index in 0..grid.cells.len() {
            let middle = grid.turned_middle(index);
            grid.cells[index].judged = polygon.contains(&middle);
            grid.cells[index].allowed = within.contains(&middle);
            grid.cells[index].last_s = f64::NEG_INFINITY;
        }
        for index in 0..grid.cells.len() {
            grid.cells[index].reached_from = grid.nearest_allowed(index);
        }
        Ok(grid)
    }

    fn nearest_allowed(&self, index: usize) -> Option<u32> {
        let far = (REACH_SHARE * self.radius_m / self.cell_m).floor() as i64;
        let (i, j) = self.place(index);
        let away = |i: i64, j: i64| i * i + j * j;
        (-far..=far)
            .flat_map(|dj| (-far..=far).map(move |di| (di, dj)))
            .filter(|(di, dj)| away(*di, *dj) <= far * far)
            .filter_map(|(di, dj)| Some((away(di, dj), self.index(i + di, j + dj)?)))
            .filter(|(_, index)| self.cells[*index].allowed)
            .min()
            .map(|(_, index)| index as u32)
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

    /// Area of a cell, cm².
    pub fn cell_cm2(&self) -> f64 {
        self.cell_m * self.cell_m * 1e4
    }

    /// Dose in a cell, N*s/cm².
    pub fn dose(&self, index: usize) -> f64 {
        self.cells[index].impulse_n_s / self.cell_cm2()
    }

    /// Adds the force of `dt_s` seconds at a point of the path's plane.
    pub fn press(&mut self, at: &Vector2<f64>, force_n: f64, time_s: f64, dt_s: f64) {
        let at = (self.turn.inverse() * at - self.low) / self.cell_m;
        if !(at.norm() < 1e6 && force_n > 0.0) {
            return;
        }
        let r = self.radius_m / self.cell_m;
        let (i0, i1) = ((at.x - r).floor() as i64, (at.x + r).floor() as i64);
        let (j0, j1) = ((at.y - r).floor() as i64, (at.y + r).floor() as i64);
        let away = |i: i64, j: i64| (Vector2::new(i as f64 + 0.5, j as f64 + 0.5) - at).norm();
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
        let cell_cm2 = self.cell_cm2();
        for index in 0..self.cells.len() {
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
