//! A normal for every pixel that has depth, from the planes of the cells around it.

use std::ops::Range;

use super::facets::Mesh;
use super::image::DepthImage;
use super::windows::Node;

/// Unit normal of a pixel, camera axes, out of the material; all zero if there is none.
pub type PixelNormal = [f32; 3];

/// Grid from which the normals are computed.
pub(super) struct Field<'a> {
    pub nodes: &'a [Node],
    pub columns: usize,
    pub rows: usize,
    pub cell_px: usize,
    pub mesh: Mesh,
    /// As returned by `DepthNormalConfig::jump`.
    pub jump: [f64; 2],
    pub range_m: [f64; 2],
}

/// Part of a row over which inverse depth and its slopes are linear: value, and change per cell.
struct Line {
    /// Position of the first pixel, and step from pixel to pixel, cells.
    first: f32,
    step: f32,
    w: [f32; 2],
    a: [f32; 2],
    b: [f32; 2],
    /// `x/z` of the first pixel, and step from pixel to pixel.
    ray: [f32; 2],
    /// `y/z` of the row.
    row_ray: f32,
    range: [f32; 2],
}

/// Number of pixels processed together.
const LANES: usize = 8;
/// Number of squares processed together.
const SQUARES: usize = 32;

/// The pixels between four nodes.
#[derive(Clone, Default)]
struct Square {
    /// Column and row of the first node.
    at: [usize; 2],
    /// Range of pixels along the rows.
    pixels: Range<usize>,
    /// Values at the corners, from [`Field::corners`].
    corners: Option<[[f32; 3]; 4]>,
    /// Position of the first pixel relative to the first node, cells, and its `x/z`.
    first: f32,
    ray: f32,
}

impl Line {
    fn fill(&self, depths: &[f32], normals: &mut [PixelNormal]) {
        let (whole, rest) = depths.as_chunks::<LANES>();
        let (to, last) = normals.as_chunks_mut::<LANES>();
        let mut from = 0;
        for (normals, z) in to.iter_mut().zip(whole) {
            self.lanes(from as f32, z, normals);
            from += LANES;
        }
        if !rest.is_empty() {
            let (mut z, mut normals) = ([0.0; LANES], [[0.0; 3]; LANES]);
            z[..rest.len()].copy_from_slice(rest);
            self.lanes(from as f32, &z, &mut normals);
            last.copy_from_slice(&normals[..last.len()]);
        }
    }

    fn lanes(&self, from: f32, z: &[f32; LANES], normals: &mut [PixelNormal; LANES]) {
        let mut out = [[0.0; LANES]; 3];
        for k in 0..LANES {
            let i = from + k as f32;
            let share = self.first + i * self.step;
            let w = self.w[0] + self.w[1] * share;
            let wa = self.a[0] + self.a[1] * share;
            let wb = self.b[0] + self.b[1] * share;
            let wc = w - (self.ray[0] + self.ray[1] * i) * wa - self.row_ray * wb;
            let square = wa * wa + wb * wb + wc * wc;
            let reads = (z[k] >= self.range[0]) & (z[k] <= self.range[1]) & (square > 0.0);
            let length = if reads { square } else { 1.0 }.sqrt();
            let scale = if reads { -1.0 } else { 0.0 } / length;
            out[0][k] = wa * scale;
            out[1][k] = wb * scale;
            out[2][k] = wc * scale;
        }
        for (k, normal) in normals.iter_mut().enumerate() {
            *normal = [out[0][k], out[1][k], out[2][k]];
        }
    }
}

impl Field<'_> {
    /// Fills `normals`, one per pixel of the image.
    pub fn fill(&self, image: &DepthImage<'_>, normals: &mut [PixelNormal]) {
        // Between four nodes inverse depth and its slopes are bilinear; beyond the outermost nodes,
        // the outermost square is extrapolated. Several squares are processed together row by row,
        // so that memory is written sequentially.
        let (rows, columns) = (self.rows.max(2) - 1, self.columns.max(2) - 1);
        let mut squares: [Square; SQUARES] = Default::default();
        for row in 0..rows {
            for first in (0..columns).step_by(SQUARES) {
                let squares = &mut squares[..SQUARES.min(columns - first)];
                for (column, square) in (first..).zip(&mut *squares) {
                    *square = self.square(column, row, image.width());
                }
                for v in self.between(row, self.rows, image.height()) {
                    for square in &*squares {
                        let line = v * image.width();
                        let normals =
                            &mut normals[line + square.pixels.start..line + square.pixels.end];
                        self.line(square, v, &image.row(v)[square.pixels.clone()], normals);
                    }
                }
            }
        }
    }

    /// Pixels from a node to the next; the first and last ranges extend to the border.
    fn between(&self, node: usize, nodes: usize, size: usize) -> Range<usize> {
        let middle = self.cell_px.div_ceil(2);
        let from = if node == 0 {
            0
        } else {
            node * self.cell_px + middle
        };
        let last = node + 2 >= nodes;
        let to = if last {
            size
        } else {
            (node + 1) * self.cell_px + middle
        };
        from.min(size)..to.min(size)
    }

    fn square(&self, column: usize, row: usize, width: usize) -> Square {
        let pixels = self.between(column, self.columns, width);
        let first = self.place(pixels.start);
        Square {
            at: [column, row],
            corners: self.corners(column, row),
            first: (first - column as f64) as f32,
            ray: self.mesh.ray(first, 0.0)[0] as f32,
            pixels,
        }
    }

    /// Position of a pixel in the grid, cells.
    fn place(&self, pixel: usize) -> f64 {
        let cell = self.cell_px as f64;
        (pixel as f64 - 0.5 * (cell - 1.0)) / cell
    }

    /// Computes one row of a square's pixels.
    fn line(&self, square: &Square, v: usize, depths: &[f32], normals: &mut [PixelNormal]) {
        let at = self.place(v);
        let Some(corners) = &square.corners else {
            for (i, (normal, z)) in normals.iter_mut().zip(depths).enumerate() {
                let place = [self.place(square.pixels.start + i), at];
                *normal = self.nearest(square.at, place, *z);
            }
            return;
        };
        let fraction = (at - square.at[1] as f64) as f32;
        let mix = |i: usize| {
            let side = |k: usize| corners[k][i] + (corners[k + 2][i] - corners[k][i]) * fraction;
            [side(0), side(1) - side(0)]
        };
        let cell = self.cell_px as f64;
        let line = Line {
            first: square.first,
            step: 1.0 / cell as f32,
            w: mix(0),
            a: mix(1),
            b: mix(2),
            ray: [square.ray, (self.mesh.step[0] / cell) as f32],
            row_ray: self.mesh.ray(0.0, at)[1] as f32,
            range: self.range_m.map(|m| m as f32),
        };
        line.fill(depths, normals);
    }

    /// Inverse depth and its slopes at the four surrounding nodes, if all belong to one surface.
    fn corners(&self, column: usize, row: usize) -> Option<[[f32; 3]; 4]> {
        if self.columns < 2 || self.rows < 2 {
            return None;
        }
        let k = row * self.columns + column;
        let four = [k, k + 1, k + self.columns, k + self.columns + 1].map(|k| &self.nodes[k]);
        if four.iter().any(|n| !n.valid) {
            return None;
        }
        let limit = self.jump[0] + self.jump[1] * four[0].w;
        let apart = |m: &Node, n: &Node, axis: usize| {
            (m.w + 0.5 * m.slope[axis] - n.w + 0.5 * n.slope[axis]).abs() > limit
        };
        if apart(four[0], four[1], 0)
            || apart(four[2], four[3], 0)
            || apart(four[0], four[2], 1)
            || apart(four[1], four[3], 1)
        {
            return None;
        }
        let [step_a, step_b] = self.mesh.step;
        Some(four.map(|n| {
            [
                n.w as f32,
                (n.slope[0] / step_a) as f32,
                (n.slope[1] / step_b) as f32,
            ]
        }))
    }

    /// The surrounding plane closest to the pixel's own depth: from the square's own nodes, or from
    /// nodes further away if none of them fits.
    fn nearest(&self, square: [usize; 2], [column, row]: [f64; 2], z: f32) -> PixelNormal {
        if !self.reads(z) {
            return [0.0; 3];
        }
        let w = 1.0 / f64::from(z);
        let limit = self.jump[0] + self.jump[1] * w;
        let mut best: (f64, Option<(&Node, f64)>) = (f64::INFINITY, None);
        for reach in [0, 1, 2] {
            let around =
                |at: usize, size: usize| at.saturating_sub(reach)..(at + 2 + reach).min(size);
            for j in around(square[1], self.rows) {
                for i in around(square[0], self.columns) {
                    let node = &self.nodes[j * self.columns + i];
                    if !node.valid {
                        continue;
                    }
                    let (du, dv) = (column - i as f64, row - j as f64);
                    let there = node.w + node.slope[0] * du + node.slope[1] * dv;
                    let off = (there - w).abs() + limit * 0.1 * (du * du + dv * dv);
                    if off < best.0 {
                        best = (off, Some((node, there)));
                    }
                }
            }
            // Searches further away only for a pixel that belongs to no surface here, and furthest
            // only if there is no surface here.
            if best.0 < limit || (reach == 1 && best.1.is_some()) {
                break;
            }
        }
        let Some((node, there)) = best.1 else {
            return [0.0; 3];
        };
        let ray = self.mesh.ray(column, row);
        let [step_a, step_b] = self.mesh.step;
        let [wa, wb] = [node.slope[0] / step_a, node.slope[1] / step_b].map(|x| x as f32);
        self.unit(there as f32, wa, wb, ray[0] as f32, ray[1] as f32, z)
    }

    fn reads(&self, z: f32) -> bool {
        f64::from(z) >= self.range_m[0] && f64::from(z) <= self.range_m[1]
    }

    fn unit(&self, w: f32, wa: f32, wb: f32, a: f32, b: f32, z: f32) -> PixelNormal {
        let wc = w - a * wa - b * wb;
        let length = (wa * wa + wb * wb + wc * wc).sqrt();
        let near = self.range_m[0] as f32;
        let far = self.range_m[1] as f32;
        let scale = if z >= near && z <= far && length > 0.0 {
            -1.0 / length
        } else {
            0.0
        };
        [wa * scale, wb * scale, wc * scale]
    }
}
