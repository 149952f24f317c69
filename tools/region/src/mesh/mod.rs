//! A mesh of triangles, checked, with vertices at the same place joined.

mod obj;
mod ply;
mod read;
mod stl;

use std::collections::HashMap;

use nalgebra::{SVector, Vector3};
use tangent_mechanics::{Base, Pose};

use crate::error::RegionError;

pub use read::read;

/// Most triangles of a mesh, and most points of a cloud.
pub(crate) const COUNT_MAX: usize = 2_000_000;
/// Vertices that are nearer than this share of the mesh's size are one.
const SAME_SHARE: f64 = 1e-7;
/// Smallest and largest size of a part, m.
const SIZE_M: (f64, f64) = (0.002, 20.0);
/// Smallest area of a triangle, as a share of the squared size of the mesh.
const AREA_SHARE: f64 = 1e-14;

/// Axes of the file.
#[derive(Clone, Copy, Debug)]
pub enum MeshFrame {}

/// A mesh, or the points of a scan if it has no triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Places, m (or units of the file, before [`Mesh::placed`]).
    pub vertices: Vec<Vector3<f64>>,
    /// Indices of the corners of each triangle, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Triangles without an area, which were left out.
    pub degenerate: usize,
}

impl Mesh {
    /// Joins vertices at the same place, and leaves out triangles without an area.
    ///
    /// # Errors
    /// A coordinate is not finite, an index is not that of a vertex, or nothing is left.
    pub fn new(vertices: Vec<Vector3<f64>>, triangles: Vec<[u32; 3]>) -> Result<Self, String> {
        if let Some(index) = (vertices.iter()).position(|v| !v.iter().all(|x| x.abs() < 1e9)) {
            let v = vertices[index];
            return Err(format!(
                "vertex {index} is at ({}, {}, {}): allowed are finite numbers below 1e9",
                v.x, v.y, v.z
            ));
        }
        let count = vertices.len();
        if let Some(index) = (triangles.iter()).position(|t| t.iter().any(|i| *i as usize >= count))
        {
            return Err(format!(
                "triangle {index} has the vertices {:?}: allowed are 0 to {}",
                triangles[index],
                count.saturating_sub(1)
            ));
        }
        let (low, high) = bounds(vertices.iter().copied());
        let size = (high - low).amax();
        let unit = (size * SAME_SHARE).max(f64::MIN_POSITIVE);
        let mut seen: HashMap<[i64; 3], u32> = HashMap::new();
        let mut joined = Vec::new();
        let mut of = Vec::with_capacity(count);
        for v in &vertices {
            let key = ((v - low) / unit).map(|x| x.round() as i64);
            let next = joined.len() as u32;
            let index = *seen.entry(key.into()).or_insert(next);
            if index == next {
                joined.push(*v);
            }
            of.push(index);
        }
        let mut mesh = Self {
            vertices: joined,
            ..Self::default()
        };
        let least = AREA_SHARE * size * size;
        for triangle in &triangles {
            let triangle = triangle.map(|i| of[i as usize]);
            if mesh.cross(&triangle).norm() > least {
                mesh.triangles.push(triangle);
            } else {
                mesh.degenerate += 1;
            }
        }
        if mesh.triangles.is_empty() && !triangles.is_empty() {
            return Err(format!(
                "none of its {} triangles has an area",
                triangles.len()
            ));
        }
        if mesh.vertices.len() < 3 {
            return Err(format!(
                "it has {} different points: allowed are 3 or more",
                mesh.vertices.len()
            ));
        }
        Ok(mesh)
    }

    /// The points of a scan, m.
    ///
    /// # Errors
    /// A coordinate is not finite, or there are too few or too many points.
    pub fn of_points(points: Vec<Vector3<f64>>) -> Result<Self, RegionError> {
        if points.len() > COUNT_MAX {
            let allowed = format!("at most {COUNT_MAX} points");
            return Err(RegionError::option("the scan", points.len(), allowed));
        }
        Self::new(points, Vec::new()).map_err(RegionError::Nothing)
    }

    /// The mesh in base axes: scaled to metres, and placed.
    ///
    /// # Errors
    /// Its size is not that of a part.
    pub fn placed(
        mut self,
        scale: f64,
        base_from_mesh: &Pose<Base, MeshFrame>,
    ) -> Result<Self, RegionError> {
        if !(1e-6..=1e3).contains(&scale) {
            return Err(RegionError::option("--scale", scale, "0.000001 to 1000"));
        }
        let (low, high) = bounds(self.vertices.iter().copied());
        let size_m = (high - low).amax() * scale;
        if !(SIZE_M.0..=SIZE_M.1).contains(&size_m) {
            return Err(RegionError::Size { size_m });
        }
        for v in &mut self.vertices {
            *v = base_from_mesh.transform_point(&(*v * scale));
        }
        Ok(self)
    }

    /// Twice the area vector of a triangle.
    fn cross(&self, triangle: &[u32; 3]) -> Vector3<f64> {
        let [a, b, c] = triangle.map(|i| self.vertices[i as usize]);
        (b - a).cross(&(c - a))
    }

    /// Area, m², times the unit normal of a triangle.
    pub fn area_vector(&self, index: usize) -> Vector3<f64> {
        0.5 * self.cross(&self.triangles[index])
    }

    /// Unit normal of a triangle.
    pub fn normal(&self, index: usize) -> Vector3<f64> {
        self.cross(&self.triangles[index]).normalize()
    }

    /// Corners of a triangle, m.
    pub fn corners(&self, index: usize) -> [Vector3<f64>; 3] {
        self.triangles[index].map(|i| self.vertices[i as usize])
    }
}

/// Least and greatest coordinates; zero without a point.
pub(crate) fn bounds<const D: usize>(
    points: impl IntoIterator<Item = SVector<f64, D>>,
) -> (SVector<f64, D>, SVector<f64, D>) {
    (points.into_iter().map(|p| (p, p)))
        .reduce(|(low, high), (p, _)| (low.inf(&p), high.sup(&p)))
        .unwrap_or_else(|| (SVector::zeros(), SVector::zeros()))
}
