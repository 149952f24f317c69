//! Nodes of the grid in space: a point and a unit normal per cell, camera axes.

use nalgebra::Vector3;

use super::image::Intrinsics;
use super::inverse_depth::InverseDepth;
use super::windows::Node;

/// Position and orientation of a cell in space.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Facet {
    /// Whether the cell has a facet: a node in front of the camera that is not steeper than
    /// allowed.
    pub valid: bool,
    /// Point on the surface, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material.
    pub normal: Vector3<f64>,
    /// Standard deviation of the normal along its less certain axis, rad.
    pub sd_rad: f64,
}

/// Conversion between cells of the grid and rays of the camera.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Mesh {
    /// Ray through the middle of cell (0, 0), `[x/z, y/z]`.
    pub first: [f64; 2],
    /// Difference between the rays of neighbouring cells, `[x/z, y/z]`.
    pub step: [f64; 2],
}

impl Mesh {
    pub fn new(intrinsics: &Intrinsics, cell_px: usize) -> Self {
        let middle = 0.5 * (cell_px as f64 - 1.0);
        Self {
            first: intrinsics.ray(middle, middle),
            step: [
                cell_px as f64 / intrinsics.fx_px,
                cell_px as f64 / intrinsics.fy_px,
            ],
        }
    }

    /// Ray through a place in the grid, given in cells.
    pub fn ray(&self, column: f64, row: f64) -> [f64; 2] {
        [
            self.first[0] + column * self.step[0],
            self.first[1] + row * self.step[1],
        ]
    }

    /// Place in the grid that a ray passes through, cells.
    pub fn place(&self, ray: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|i| (ray[i] - self.first[i]) / self.step[i])
    }

    /// The surface around a node, as inverse depth.
    pub fn inverse_depth(&self, node: &Node, column: usize, row: usize) -> InverseDepth {
        InverseDepth {
            ray: self.ray(column as f64, row as f64),
            w: node.w,
            slope: [node.slope[0] / self.step[0], node.slope[1] / self.step[1]],
            bend: [0.0; 3],
        }
    }

    /// Computes the facet of every node.
    pub fn facets(&self, nodes: &[Node], columns: usize, cos_steepest: f64, facets: &mut [Facet]) {
        for (i, (facet, node)) in facets.iter_mut().zip(nodes).enumerate() {
            *facet = Facet::default();
            if !node.valid {
                continue;
            }
            let at = self.inverse_depth(node, i % columns, i / columns);
            if let (Some(point), Some(normal)) = (at.point(), at.normal())
                && -normal.dot(&point) >= cos_steepest * point.norm()
            {
                let [uu, _, vv] = node.covariance;
                let [step_a, step_b] = self.step;
                let most = (uu / (step_a * step_a)).max(vv / (step_b * step_b));
                *facet = Facet {
                    valid: true,
                    point,
                    normal,
                    sd_rad: most.sqrt() / at.gradient().norm(),
                };
            }
        }
    }
}
