//! A normal for every pixel that has depth, from the planes of the cells around it.

use std::ops::Range;

use super::facets::Mesh;
use super::image::DepthImage;
use super::windows::Node;

/// Unit normal of a pixel, camera axes, out of the material; all zero where there is none.
pub type PixelNormal = [f32; 3];

/// The grid that the normals come from.
pub(super) struct Field<'a> {
    pub nodes: &'a [Node],
    pub columns: usize,
    pub rows: usize,
    pub cell_px: usize,
    pub mesh: Mesh,
    /// As in `DepthNormalConfig::jump`.
    pub jump: [f64; 2],
    pub range_m: [f64; 2],
}

/// A stretch of a row over which inverse depth and its slopes are linear: value and change per cell.
struct Line {
    /// Place of the first pixel, and from pixel to pixel, cells.
    first: f32,
    step: f32,
    w: [f32; 2],
    a: [f32; 2],
    b: [f32; 2],
    /// `x/z` of the first pixel, and from pixel to pixel.
    sight: [f32; 2],
    /// `y/z` of the row.
    row_sight: f32,
    range: [f32; 2],
}

/// Pixels that are worked on together.
const LANES: usize = 8;

impl Line {
    fn fill(&self, depths: &[f32], normals: &mut [PixelNormal]) {
        let mut from = 0;
        for (normals, depths) in normals.chunks_mut(LANES).zip(depths.chunks(LANES)) {
            let mut z = [0.0; LANES];
            z[..depths.len()].copy_from_slice(depths);
            let [x, y, z] = self.lanes(from as f32, &z);
            for (normal, ((x, y), z)) in normals.iter_mut().zip(x.iter().zip(&y).zip(&z)) {
                *normal = [*x, *y, *z];
            }
            from += LANES;
        }
    }

    fn lanes(&self, from: f32, z: &[f32; LANES]) -> [[f32; LANES]; 3] {
        let mut out = [[0.0; LANES]; 3];
        for k in 0..LANES {
            let i = from + k as f32;
            let share = self.first + i * self.step;
            let w = self.w[0] + self.w[1] * share;
            let wa = self.a[0] + self.a[1] * share;
            let wb = self.b[0] + self.b[1] * share;
            let wc = w - (self.sight[0] + self.sight[1] * i) * wa - self.row_sight * wb;
            let square = wa * wa + wb * wb + wc * wc;
            let reads = (z[k] >= self.range[0]) & (z[k] <= self.range[1]) & (square > 0.0);
            let length = if reads { square } else { 1.0 }.sqrt();
            let scale = if reads { -1.0 } else { 0.0 } / length;
            out[0][k] = wa * scale;
            out[1][k] = wb * scale;
            out[2][k] = wc * scale;
        }
        out
    }
}

impl Field<'_> {
    /// Fills `normals`, one per pixel of the image.
    pub fn fill(&self, image: &DepthImage<'_>, normals: &mut [PixelNormal]) {
        // Between four nodes inverse depth and its slopes are bilinear; beyond the outermost, their own square goes on.
        for row in 0..self.rows.max(2) - 1 {
            let lines = self.between(row, self.rows, image.height());
            for column in 0..self.columns.max(2) - 1 {
                let pixels = self.between(column, self.columns, image.width());
                self.square([column, row], pixels, lines.clone(), image, normals);
            }
        }
    }

    /// Pixels from a node to the next; from the border on, and to it.
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

    fn square(
        &self,
        [column, row]: [usize; 2],
        pixels: Range<usize>,
        lines: Range<usize>,
        image: &DepthImage<'_>,
        normals: &mut [PixelNormal],
    ) {
        let cell = self.cell_px as f64;
        let place = |pixel: usize| (pixel as f64 - 0.5 * (cell - 1.0)) / cell;
        let corners = self.corners(column, row);
        let first = place(pixels.start) - column as f64;
        let sight = [
            self.mesh.sight(place(pixels.start), 0.0)[0] as f32,
            (self.mesh.step[0] / cell) as f32,
        ];
        let range = self.range_m.map(|m| m as f32);
        for v in lines {
            let depths = &image.row(v)[pixels.clone()];
            let line = v * image.width();
            let normals = &mut normals[line + pixels.start..line + pixels.end];
            let at = place(v);
            let Some(corners) = &corners else {
                for (i, (normal, z)) in normals.iter_mut().zip(depths).enumerate() {
                    *normal = self.nearest([column, row], [place(pixels.start + i), at], *z);
                }
                continue;
            };
            let fraction = (at - row as f64) as f32;
            let mix = |i: usize| {
                let side =
                    |k: usize| corners[k][i] + (corners[k + 2][i] - corners[k][i]) * fraction;
                [side(0), side(1) - side(0)]
            };
            let line = Line {
                first: first as f32,
                step: 1.0 / cell as f32,
                w: mix(0),
                a: mix(1),
                b: mix(2),
                sight,
                row_sight: self.mesh.sight(0.0, at)[1] as f32,
                range,
            };
            line.fill(depths, normals);
        }
    }

    /// Inverse depth and its slopes at the four nodes around, where all are of one surface.
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

    /// The plane around that is nearest to what the pixel itself says: of the square's own nodes, or of those beyond where none
    /// of them fits.
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
            // Further away only for a pixel that is of no surface here, and furthest only where there is none.
            if best.0 < limit || (reach == 1 && best.1.is_some()) {
                break;
            }
        }
        let Some((node, there)) = best.1 else {
            return [0.0; 3];
        };
        let sight = self.mesh.sight(column, row);
        let [step_a, step_b] = self.mesh.step;
        let [wa, wb] = [node.slope[0] / step_a, node.slope[1] / step_b].map(|x| x as f32);
        self.unit(there as f32, wa, wb, sight[0] as f32, sight[1] as f32, z)
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
