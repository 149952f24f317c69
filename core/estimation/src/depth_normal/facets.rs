//! The grid's nodes in space: a point and a unit normal per cell, camera axes.

use nalgebra::Vector3;

use super::image::Intrinsics;
use super::inverse_depth::InverseDepth;
use super::windows::Node;

/// A cell's place and orientation in space.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Facet {
    /// Whether there is one: a node before the camera that is not steeper than allowed.
    pub valid: bool,
    /// m
    pub point: Vector3<f64>,
    /// Out of the material.
    pub normal: Vector3<f64>,
    /// Standard deviation of the normal, the larger way, rad.
    pub sd_rad: f64,
}

/// From cells to lines of sight.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Mesh {
    /// `[x/z, y/z]` of the middle of cell (0, 0).
    pub first: [f64; 2],
    /// The same from cell to cell.
    pub step: [f64; 2],
}

impl Mesh {
    pub fn new(intrinsics: &Intrinsics, cell_px: usize) -> Self {
        let middle = 0.5 * (cell_px as f64 - 1.0);
        Self {
            first: intrinsics.sight(middle, middle),
            step: [
                cell_px as f64 / intrinsics.fx_px,
                cell_px as f64 / intrinsics.fy_px,
            ],
        }
    }

    /// Of a place in the grid, cells.
    pub fn sight(&self, column: f64, row: f64) -> [f64; 2] {
        [
            self.first[0] + column * self.step[0],
            self.first[1] + row * self.step[1],
        ]
    }

    /// Place in the grid of a line of sight, cells.
    pub fn place(&self, sight: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|i| (sight[i] - self.first[i]) / self.step[i])
    }

    /// A node as what it says of the surface.
    pub fn inverse_depth(&self, node: &Node, column: usize, row: usize) -> InverseDepth {
        InverseDepth {
            sight: self.sight(column as f64, row as f64),
            w: node.w,
            slope: [node.slope[0] / self.step[0], node.slope[1] / self.step[1]],
            bend: [0.0; 3],
        }
    }

    /// Every node's facet.
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
