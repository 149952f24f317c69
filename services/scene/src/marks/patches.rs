//! Places on the surface, at most one in each cell of a grid: the size follows from the surface and
//! not from the time.

use std::collections::HashMap;

use nalgebra::Vector3;
use tangent_schemas::standard::{ColorRGBA, Marker};

use super::Seen;
use super::blocks::{BLOCK, Blocks, POINTS_MAX};
use super::shape::{kind, marker, removed};
use crate::pressed::cross_axes;

/// Cells across the radius of the tip that are covered at a time.
const CELLS_PER_RADIUS: f64 = 3.0;
/// Smallest cell, m.
const CELL_MIN_M: f64 = 0.001;

/// A place on the surface.
#[derive(Clone, Copy, Debug)]
struct Patch {
    point: Vector3<f64>,
    /// Force over the wanted force.
    force: f64,
}

/// What a layer shows.
enum Look {
    /// Spheres in the colour of the force.
    Force,
    /// Flat cubes in one colour, for each cell within the radius of the tip, m.
    Covered(f64),
}

/// A layer of places. When it is full, its cells become twice as large.
pub struct Patches {
    name: &'static str,
    look: Look,
    cell_min_m: f64,
    cell_m: f64,
    patches: Vec<Patch>,
    places: HashMap<[i64; 3], usize>,
    blocks: Blocks,
}

impl Patches {
    /// Places touched, coloured by the force.
    pub fn touched(name: &'static str, cell_m: f64) -> Self {
        Self::new(name, cell_m, Look::Force)
    }

    /// Places under a tip of this radius, m.
    pub fn covered(name: &'static str, radius_m: f64) -> Self {
        let cell_m = (radius_m / CELLS_PER_RADIUS).max(CELL_MIN_M);
        Self::new(name, cell_m, Look::Covered(radius_m))
    }

    fn new(name: &'static str, cell_m: f64, look: Look) -> Self {
        Self {
            name,
            look,
            cell_min_m: cell_m,
            cell_m,
            patches: Vec::new(),
            places: HashMap::new(),
            blocks: Blocks::default(),
        }
    }

    /// Removes all places.
    pub fn clear(&mut self) {
        for block in 0..self.end() {
            self.blocks.remove(block);
        }
        self.patches.clear();
        self.places.clear();
        self.cell_m = self.cell_min_m;
    }

    fn end(&self) -> usize {
        self.patches.len().div_ceil(BLOCK)
    }

    /// The tool touches here, world axes, m, with this share of the wanted force.
    pub fn touch(&mut self, point: Vector3<f64>, force: f64) {
        if point.iter().all(|x| x.is_finite()) {
            self.put(Patch { point, force });
        }
    }

    /// The tip covers the surface about this point, world axes, m. `normal` is of unit length.
    pub fn cover(&mut self, middle: Vector3<f64>, normal: &Vector3<f64>) {
        let Look::Covered(radius_m) = self.look else {
            return;
        };
        if !middle.iter().chain(normal.iter()).all(|x| x.is_finite()) {
            return;
        }
        let (x, y) = cross_axes(normal);
        let count = (radius_m / self.cell_m).floor() as i32;
        for i in -count..=count {
            for j in -count..=count {
                let (a, b) = (f64::from(i) * self.cell_m, f64::from(j) * self.cell_m);
                if a.hypot(b) <= radius_m {
                    let point = middle + x * a + y * b;
                    self.put(Patch { point, force: 1.0 });
                }
            }
        }
    }

    fn put(&mut self, patch: Patch) {
        let place = self.place(&patch.point);
        let index = match self.places.get(&place) {
            // What is covered stays as it is; a touched place has the newest force.
            Some(_) if matches!(self.look, Look::Covered(_)) => return,
            Some(&index) => {
                self.patches[index].force = patch.force;
                index
            }
            None => {
                if self.patches.len() == POINTS_MAX {
                    self.thin();
                    return self.put(patch);
                }
                self.places.insert(place, self.patches.len());
                self.patches.push(patch);
                self.patches.len() - 1
            }
        };
        self.blocks.change(index / BLOCK);
    }

    /// Doubles the cells until a quarter of the places is free.
    fn thin(&mut self) {
        let blocks = self.end();
        let old = std::mem::take(&mut self.patches);
        loop {
            self.cell_m *= 2.0;
            self.places.clear();
            self.patches.clear();
            for patch in &old {
                let place = self.place(&patch.point);
                if !self.places.contains_key(&place) {
                    self.places.insert(place, self.patches.len());
                    self.patches.push(*patch);
                }
            }
            if self.patches.len() <= POINTS_MAX / 4 * 3 {
                break;
            }
        }
        for block in 0..self.end() {
            self.blocks.change(block);
        }
        for block in self.end()..blocks {
            self.blocks.remove(block);
        }
    }

    fn place(&self, point: &Vector3<f64>) -> [i64; 3] {
        [point.x, point.y, point.z].map(|x| (x / self.cell_m).floor() as i64)
    }

    pub fn draw(&mut self, seen: &Seen, markers: &mut Vec<Marker>) {
        for block in self.blocks.gone() {
            markers.push(removed(seen.stamp, self.name, block as i32));
        }
        let Some(block) = self.blocks.next(seen.now, 0, self.end()) else {
            return;
        };
        let patches = self.patches[block * BLOCK..].iter().take(BLOCK);
        let (form, color) = match self.look {
            Look::Force => (kind::SPHERE_LIST, [0.2, 0.8, 0.3]),
            Look::Covered(_) => (kind::CUBE_LIST, [0.15, 0.65, 0.85]),
        };
        let mut cloud = marker(seen.stamp, "world", self.name, form, color);
        cloud.id = block as i32;
        (cloud.scale.x, cloud.scale.y, cloud.scale.z) = (self.cell_m, self.cell_m, self.cell_m);
        cloud.points = patches.clone().map(|patch| (&patch.point).into()).collect();
        match self.look {
            Look::Force => cloud.colors = patches.map(|patch| by_force(patch.force)).collect(),
            Look::Covered(_) => cloud.color.a = 0.5,
        }
        markers.push(cloud);
    }
}

/// Blue without force, green at the wanted force, red at twice that and beyond.
fn by_force(share: f64) -> ColorRGBA {
    let share = share.clamp(0.0, 2.0) as f32;
    ColorRGBA {
        r: (share - 1.0).max(0.0),
        g: 1.0 - (share - 1.0).abs(),
        b: (1.0 - share).max(0.0),
        a: 1.0,
    }
}
