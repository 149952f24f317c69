//! A surface as heights over the plane of a task, on a grid: made of the triangles of a mesh, or of
//! the points of a scan.

use std::collections::HashMap;

use nalgebra::{Vector2, Vector3};
use tangent_control::fill::Polygon;

use crate::error::RegionError;
use crate::mesh::{Mesh, bounds};
use crate::patch::edges;
use crate::plane::TaskPlane;

/// Most nodes of a grid.
pub(crate) const NODES_MAX: usize = 400_000;
/// Steepest part of a region against the approach, degrees.
const STEEP_MAX_DEG: f64 = 70.0;
/// Triangles smaller than this do not make a region too steep, m².
const SLIVER_M2: f64 = 1e-8;
/// Heights at one place that differ by more than this are of two surfaces, m.
const APART_M: f64 = 0.001;
/// Border around the surface, nodes.
pub(crate) const BORDER: usize = 3;
/// Steepest part of the surroundings of a region that are looked at, cosine.
const AROUND_COSINE: f64 = 0.5;

/// Heights over a plane. Places are in axes of the plane, m.
#[derive(Clone, Debug)]
pub struct HeightMap {
    /// The plane.
    pub plane: TaskPlane,
    /// Place of the first node, m.
    pub low: Vector2<f64>,
    /// Distance between nodes, m.
    pub cell_m: f64,
    /// Nodes along x.
    pub columns: usize,
    /// Nodes along y.
    pub rows: usize,
    /// Height of each node, m; not a number where there is no surface.
    pub heights_m: Vec<f64>,
    /// Whether a node is in the region.
    pub inside: Vec<bool>,
    /// Edges of the region on the surface, in short pieces: x, y and height, m.
    pub edges: Vec<[Vector3<f64>; 2]>,
}

impl HeightMap {
    /// An empty map over a box, with a border.
    pub(crate) fn empty(
        plane: TaskPlane,
        low: Vector2<f64>,
        high: Vector2<f64>,
        cell_m: f64,
    ) -> Self {
        let border = BORDER as f64 * cell_m;
        let low = low - Vector2::repeat(border);
        let count = |length: f64| ((length + border) / cell_m).ceil().max(1.0) as usize + 1;
        let (columns, rows) = (count(high.x - low.x), count(high.y - low.y));
        Self {
            plane,
            low,
            cell_m,
            columns,
            rows,
            heights_m: vec![f64::NAN; columns * rows],
            inside: vec![false; columns * rows],
            edges: Vec::new(),
        }
    }

    /// Of the triangles `patch` of a mesh. What the mesh has around them within `around_m` gives
    /// heights beside the region.
    ///
    /// # Errors
    /// The patch is too steep, or lies above itself.
    pub fn of_mesh(
        mesh: &Mesh,
        patch: &[usize],
        plane: &TaskPlane,
        cell_m: f64,
        around_m: f64,
    ) -> Result<Self, RegionError> {
        let corners = |index: usize| mesh.corners(index).map(|v| plane.place(&v));
        let (low, high) = bounds(patch.iter().flat_map(|i| corners(*i)).map(|v| v.xy()));
        let around = Vector2::repeat(around_m);
        let mut map = Self::empty(*plane, low - around, high + around, cell_m);
        let steep_max = STEEP_MAX_DEG.to_radians().cos();
        for &index in patch {
            let area = mesh.area_vector(index);
            let cosine = area.dot(&plane.normal) / area.norm();
            if cosine < steep_max && area.norm() > SLIVER_M2 {
                return Err(RegionError::Steep {
                    at_m: mesh.corners(index)[0].into(),
                    angle_deg: cosine.acos().to_degrees(),
                    max_deg: STEEP_MAX_DEG,
                });
            }
        }
        let mut apart: Option<(usize, f64)> = None;
        for &index in patch {
            map.raster(&corners(index), |heights_m, node, height_m| {
                let apart_m = (heights_m[node] - height_m).abs();
                if apart_m > APART_M.max(0.5 * cell_m) {
                    apart = Some((node, apart_m));
                }
                if heights_m[node].is_nan() || heights_m[node] < height_m {
                    heights_m[node] = height_m;
                }
            });
        }
        if let Some((node, apart_m)) = apart {
            let at = map.place(node).push(map.heights_m[node]);
            let at_m = plane.in_base(&at).into();
            return Err(RegionError::Overlap { at_m, apart_m });
        }
        map.inside = map.heights_m.iter().map(|h| h.is_finite()).collect();
        map.edges = map.without_cracks(open_edges(mesh, patch, plane));
        let mut taken = vec![false; mesh.triangles.len()];
        patch.iter().for_each(|i| taken[*i] = true);
        let inside = map.inside.clone();
        for index in (0..taken.len()).filter(|i| !taken[*i]) {
            if mesh.normal(index).dot(&plane.normal) < AROUND_COSINE {
                continue;
            }
            map.raster(&corners(index), |heights_m, node, height_m| {
                if !inside[node] && (heights_m[node].is_nan() || heights_m[node] < height_m) {
                    heights_m[node] = height_m;
                }
            });
        }
        Ok(map)
    }

    /// Calls `hit` with the heights, the node and its height for each node below a triangle.
    fn raster(
        &mut self,
        [a, b, c]: &[Vector3<f64>; 3],
        mut hit: impl FnMut(&mut [f64], usize, f64),
    ) {
        let (ab, ac) = ((b - a).xy(), (c - a).xy());
        let area = ab.perp(&ac);
        let (low, high) = (
            a.xy().inf(&b.xy()).inf(&c.xy()),
            a.xy().sup(&b.xy()).sup(&c.xy()),
        );
        let index = |x: f64, count: usize| x.clamp(0.0, (count - 1) as f64) as usize;
        let (from, to) = (
            (low - self.low) / self.cell_m,
            (high - self.low) / self.cell_m,
        );
        if area.abs() < f64::MIN_POSITIVE
            || to.x < 0.0
            || to.y < 0.0
            || from.x > (self.columns - 1) as f64
            || from.y > (self.rows - 1) as f64
        {
            return;
        }
        for j in index(from.y.ceil(), self.rows)..=index(to.y.floor(), self.rows) {
            for i in index(from.x.ceil(), self.columns)..=index(to.x.floor(), self.columns) {
                let node = j * self.columns + i;
                let off = self.place(node) - a.xy();
                let (u, v) = (off.perp(&ac) / area, ab.perp(&off) / area);
                if u >= -1e-9 && v >= -1e-9 && u + v <= 1.0 + 1e-9 {
                    hit(
                        &mut self.heights_m,
                        node,
                        a.z + u * (b.z - a.z) + v * (c.z - a.z),
                    );
                }
            }
        }
    }

    /// Edges in short pieces, without those that have the region on both sides: cracks of a mesh
    /// whose triangles do not share vertices.
    fn without_cracks(&self, open: Vec<[Vector3<f64>; 2]>) -> Vec<[Vector3<f64>; 2]> {
        let mut pieces = Vec::new();
        for [a, b] in open {
            for piece in self.pieces(&a, &b) {
                let along = (piece[1] - piece[0]).xy();
                let Some(across) = Vector2::new(-along.y, along.x).try_normalize(1e-12) else {
                    continue;
                };
                let middle = (piece[0] + piece[1]).xy() * 0.5;
                let step = across * self.cell_m;
                if !(self.is_inside(&(middle + step)) && self.is_inside(&(middle - step))) {
                    pieces.push(piece);
                }
            }
        }
        pieces
    }

    fn pieces(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> Vec<[Vector3<f64>; 2]> {
        let count = ((b - a).xy().norm() / (2.0 * self.cell_m)).ceil().max(1.0) as usize;
        let at = |k: usize| a.lerp(b, k as f64 / count as f64);
        (0..count).map(|k| [at(k), at(k + 1)]).collect()
    }

    /// Keeps what is inside an outline, and outside of holes, drawn over the plane (x and y, m).
    pub fn cut(&mut self, outline: Option<&[[f64; 2]]>, holes: &[Vec<[f64; 2]>]) {
        let rings = outline.into_iter().map(|ring| (ring, true));
        for (ring, keeps) in rings.chain(holes.iter().map(|hole| (hole.as_slice(), false))) {
            let polygon = Polygon::new(ring, &[]);
            for node in 0..self.inside.len() {
                self.inside[node] &= polygon.contains(&self.place(node)) == keeps;
            }
            let over = |p: Vector2<f64>| p.push(self.height_m(&p).unwrap_or(0.0));
            let mut pieces = Vec::new();
            for (a, b) in polygon.edges() {
                for [a, b] in self.pieces(&a.push(0.0), &b.push(0.0)) {
                    pieces.push([over(a.xy()), over(b.xy())]);
                }
            }
            self.edges.extend(pieces);
        }
    }

    /// Place of a node, m.
    pub fn place(&self, node: usize) -> Vector2<f64> {
        let (i, j) = (node % self.columns, node / self.columns);
        self.low + Vector2::new(i as f64, j as f64) * self.cell_m
    }

    /// The node nearest to a place; `None` outside the grid.
    pub fn node(&self, at: &Vector2<f64>) -> Option<usize> {
        let at = ((at - self.low) / self.cell_m).map(f64::round);
        let inside =
            at.x >= 0.0 && at.y >= 0.0 && at.x < self.columns as f64 && at.y < self.rows as f64;
        inside.then(|| at.y as usize * self.columns + at.x as usize)
    }

    /// Whether the node nearest to a place is in the region.
    pub fn is_inside(&self, at: &Vector2<f64>) -> bool {
        self.node(at).is_some_and(|node| self.inside[node])
    }

    /// Height at a place, m: between the four nodes around it, or that of the nearest one; `None`
    /// without a surface there.
    pub fn height_m(&self, at: &Vector2<f64>) -> Option<f64> {
        let place = (at - self.low) / self.cell_m;
        let (i, j) = (place.x.floor(), place.y.floor());
        let inside =
            i >= 0.0 && j >= 0.0 && i + 1.0 < self.columns as f64 && j + 1.0 < self.rows as f64;
        if inside {
            let first = j as usize * self.columns + i as usize;
            let (u, v) = (place.x - i, place.y - j);
            let h = |k: usize| self.heights_m[k];
            let above = first + self.columns;
            let height_m = (h(first) * (1.0 - u) + h(first + 1) * u) * (1.0 - v)
                + (h(above) * (1.0 - u) + h(above + 1) * u) * v;
            if height_m.is_finite() {
                return Some(height_m);
            }
        }
        let node = self.node(at)?;
        Some(self.heights_m[node]).filter(|h| h.is_finite())
    }

    /// Unit normal at a place in axes of the plane, over `reach_m` on each side; `None` without a
    /// surface around it.
    pub fn normal(&self, at: &Vector2<f64>, reach_m: f64) -> Option<Vector3<f64>> {
        let slope = |axis: Vector2<f64>| {
            let (before, after) = (
                self.height_m(&(at - axis * reach_m))?,
                self.height_m(&(at + axis * reach_m))?,
            );
            Some((after - before) / (2.0 * reach_m))
        };
        let (x, y) = (slope(Vector2::x())?, slope(Vector2::y())?);
        Some(Vector3::new(-x, -y, 1.0).normalize())
    }

    /// Area of the region along the surface, m².
    pub fn area_m2(&self) -> f64 {
        let cell = self.cell_m * self.cell_m;
        (0..self.inside.len())
            .filter(|node| self.inside[*node])
            .map(|node| {
                let normal = self.normal(&self.place(node), self.cell_m);
                cell / normal.map_or(1.0, |n| n.z)
            })
            .sum()
    }
}

/// Edges that only one triangle of a patch has, in axes of the plane, m.
fn open_edges(mesh: &Mesh, patch: &[usize], plane: &TaskPlane) -> Vec<[Vector3<f64>; 2]> {
    let mut count: HashMap<(u32, u32), u32> = HashMap::new();
    for &index in patch {
        for edge in edges(&mesh.triangles[index]) {
            *count.entry(edge).or_default() += 1;
        }
    }
    let mut open: Vec<_> = (count.into_iter())
        .filter(|(_, count)| *count == 1)
        .map(|(edge, _)| edge)
        .collect();
    // The order of a hash map differs from run to run.
    open.sort_unstable();
    open.into_iter()
        .map(|(a, b)| [a, b].map(|i| plane.place(&mesh.vertices[i as usize])))
        .collect()
}
