//! Dose of pressure on the surface: the time integral of the pressure at each place, N*s/cm².
//!
//! The pressing force is spread evenly over a disk of the tip's radius in the tangent plane, and
//! added up in a grid. The grid lies in the tangent plane of the first contact. Where the surface
//! leans away from it by more than 60°, it lies in another plane of the same frame, so each cell
//! covers its true area on the surface. The sum over all cells is the time integral of the force.

mod judgement;
mod planes;

use std::collections::HashMap;

use nalgebra::Vector3;

pub use judgement::Judgement;

use crate::{Pressed, cross_axes};
use planes::{plane_axes, plane_for};

/// Cells across the radius of the tip.
const CELLS_PER_RADIUS: f64 = 4.0;
/// Smallest cell, m.
const CELL_MIN_M: f64 = 0.001;
/// Largest number of cells. Beyond it, cells become twice as large.
pub const CELLS_MAX: usize = 16_384;
/// More than the cells under a tip.
const UNDER_MAX: usize = 128;
/// Longest time between two states that is added up, s. A longer gap is not, and is counted.
pub const STEP_MAX_S: f64 = 0.1;
/// Plane of the grid and cell in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
struct Place {
    plane: u8,
    i: i64,
    j: i64,
}

/// A cell of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Number of the cell; it stays the same within an epoch.
    pub number: usize,
    /// Middle of the cell on the surface, m.
    pub point: Vector3<f64>,
    /// Unit normal of the surface.
    pub normal: Vector3<f64>,
    /// Time integral of the force on the cell, N*s.
    pub impulse_n_s: f64,
    /// Area of the surface in the cell, cm².
    pub area_cm2: f64,
    revision: u64,
    place: Place,
}

impl Cell {
    /// The dose, N*s/cm².
    pub fn dose(&self) -> f64 {
        self.impulse_n_s / self.area_cm2
    }
}

/// Dose of one task.
pub struct DoseMap {
    radius_m: f64,
    cell_min_m: f64,
    cell_m: f64,
    /// Axes of the frame of the first contact: two along the surface, and the normal.
    axes: Option<[Vector3<f64>; 3]>,
    plane: u8,
    cells: Vec<Cell>,
    places: HashMap<Place, usize>,
    revision: u64,
    epoch: u64,
    impulse_n_s: f64,
    /// Time during contact that was not added up, s.
    missed_s: f64,
}

impl DoseMap {
    /// An empty map for a tip of this radius, m.
    pub fn new(radius_m: f64) -> Self {
        let cell_m = (radius_m / CELLS_PER_RADIUS).max(CELL_MIN_M);
        Self {
            radius_m,
            cell_min_m: cell_m,
            cell_m,
            axes: None,
            plane: 4,
            cells: Vec::new(),
            places: HashMap::new(),
            revision: 0,
            epoch: 0,
            impulse_n_s: 0.0,
            missed_s: 0.0,
        }
    }

    /// Removes all dose, for a new task.
    pub fn clear(&mut self) {
        let epoch = self.epoch + 1;
        *self = Self::new(self.radius_m);
        self.cell_m = self.cell_min_m;
        self.epoch = epoch;
    }

    /// Adds the force of `dt_s` seconds.
    pub fn press(&mut self, pressed: &Pressed, dt_s: f64) {
        if dt_s > STEP_MAX_S {
            self.missed_s += dt_s;
            return;
        }
        if dt_s.is_nan() || dt_s <= 0.0 {
            return;
        }
        let axes = *self.axes.get_or_insert_with(|| {
            let (x, y) = cross_axes(&pressed.normal);
            [x, y, pressed.normal]
        });
        if self.cells.len() + UNDER_MAX > CELLS_MAX {
            self.thin();
        }
        self.plane = plane_for(&axes, &pressed.normal, self.plane);
        self.revision += 1;
        let impulse = pressed.force_n * dt_s;
        self.impulse_n_s += impulse;
        let under = self.under(&axes, pressed);
        let sum: f64 = under.iter().map(|one| one.3).sum();
        for (place, point, area_cm2, weight) in under {
            self.add(
                place,
                point,
                pressed.normal,
                area_cm2,
                impulse * weight / sum,
            );
        }
    }

    /// Cells under the tip: place, point on the surface, area in cm², and share.
    fn under(
        &self,
        axes: &[Vector3<f64>; 3],
        pressed: &Pressed,
    ) -> Vec<(Place, Vector3<f64>, f64, f64)> {
        let (a, b, d) = plane_axes(axes, self.plane);
        let (p, n, h, r) = (pressed.point, pressed.normal, self.cell_m, self.radius_m);
        let (u, v, lean) = (p.dot(&a), p.dot(&b), n.dot(&d));
        let area_cm2 = h * h / lean * 1e4;
        let cell = |x: f64| (x / h).floor() as i64;
        let lift = |du: f64, dv: f64| -(n.dot(&a) * du + n.dot(&b) * dv) / lean;
        let mut under = Vec::new();
        for i in cell(u - r)..=cell(u + r) {
            for j in cell(v - r)..=cell(v + r) {
                let (du, dv) = ((i as f64 + 0.5) * h - u, (j as f64 + 0.5) * h - v);
                let away = a * du + b * dv + d * lift(du, dv);
                // A cell on the rim has a part of the force.
                let weight = ((r - away.norm()) / h + 0.5).clamp(0.0, 1.0);
                if weight > 0.0 {
                    let plane = self.plane;
                    under.push((Place { plane, i, j }, p + away, area_cm2, weight));
                }
            }
        }
        // Cells that are larger than the tip may all have their middles beside it.
        if under.is_empty() {
            let (i, j, plane) = (cell(u), cell(v), self.plane);
            under.push((Place { plane, i, j }, p, area_cm2, 1.0));
        }
        under
    }

    fn add(
        &mut self,
        place: Place,
        point: Vector3<f64>,
        normal: Vector3<f64>,
        area_cm2: f64,
        impulse_n_s: f64,
    ) {
        if let Some(&number) = self.places.get(&place) {
            let cell = &mut self.cells[number];
            cell.impulse_n_s += impulse_n_s;
            (cell.point, cell.normal, cell.area_cm2) = (point, normal, area_cm2);
            cell.revision = self.revision;
            return;
        }
        let number = self.cells.len();
        self.places.insert(place, number);
        self.cells.push(Cell {
            number,
            point,
            normal,
            impulse_n_s,
            area_cm2,
            revision: self.revision,
            place,
        });
    }

    /// Doubles the cells until a quarter of them is free. The impulse is kept.
    fn thin(&mut self) {
        while self.cells.len() > CELLS_MAX / 4 * 3 {
            self.cell_m *= 2.0;
            let old = std::mem::take(&mut self.cells);
            self.places.clear();
            for cell in old {
                let place = Place {
                    i: cell.place.i.div_euclid(2),
                    j: cell.place.j.div_euclid(2),
                    ..cell.place
                };
                if let Some(&number) = self.places.get(&place) {
                    self.cells[number].impulse_n_s += cell.impulse_n_s;
                    continue;
                }
                let number = self.cells.len();
                self.places.insert(place, number);
                self.cells.push(Cell {
                    number,
                    place,
                    area_cm2: cell.area_cm2 * 4.0,
                    ..cell
                });
            }
        }
        self.epoch += 1;
    }

    /// All cells.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Cells that have changed after `revision`.
    pub fn changed(&self, revision: u64) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(move |c| c.revision > revision)
    }

    /// Number of changes so far in this epoch.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Changes whenever numbers of cells lose their meaning.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Edge of a cell in the plane of the grid, m.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Time integral of the force, N*s.
    pub fn impulse_n_s(&self) -> f64 {
        self.impulse_n_s
    }

    /// Time in contact that is not in the map, because states of the cell were missing, s.
    pub fn missed_s(&self) -> f64 {
        self.missed_s
    }
}

#[cfg(test)]
mod tests;
