//! One pass over the image: validity, edges and the sums of each cell, from which all fits are
//! computed.
//!
//! Sums are taken per column over the rows of a cell first, so that the pass is plain arithmetic on
//! whole rows, and then per cell. Coordinates are relative to the cell's middle and inverse depth
//! to a reference value of the cell, which avoids cancellation in single precision.

use super::config::{CELL_PX_MAX, DepthNormalConfig};
use super::image::DepthImage;

/// Weighted sums over the pixels of a cell. `u` and `v` are in cells from the cell's middle, `w` in
/// 1/m from `reference`. A pixel's weight is the variance from range noise alone, divided by the
/// pixel's variance.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cell {
    /// `1, u, v, uu, uv, vv, w, uw, vw, ww`.
    pub sums: [f64; 10],
    /// Reference of `w`, 1/m.
    pub reference: f64,
    /// Number of pixels with depth.
    pub depth: u32,
    /// Number of pixels with depth at an edge; they are in no sum.
    pub edge: u32,
}

impl Cell {
    /// Whether enough pixels are at a jump to indicate an edge in the cell.
    pub fn is_edge(&self) -> bool {
        self.edge >= 3 && 16 * self.edge >= self.depth
    }

    /// Mean inverse depth, 1/m.
    pub fn mean(&self) -> Option<f64> {
        (self.sums[0] > 0.0).then(|| self.reference + self.sums[6] / self.sums[0])
    }
}

/// The cells of one image, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    pub columns: usize,
    pub rows: usize,
    pub cells: Vec<Cell>,
    width: usize,
    height: usize,
    /// Inverse depth of three rows, with an empty pixel at either end.
    lines: [Vec<f32>; 3],
    columns_of: Columns,
}

/// Sums of each column of pixels over the rows of a cell.
#[derive(Clone, Debug, Default)]
struct Columns {
    reference: Vec<f32>,
    p: Vec<f32>,
    pv: Vec<f32>,
    pvv: Vec<f32>,
    pw: Vec<f32>,
    pvw: Vec<f32>,
    pww: Vec<f32>,
    depth: Vec<f32>,
    edge: Vec<f32>,
}

impl Columns {
    fn all(&mut self) -> [&mut Vec<f32>; 9] {
        [
            &mut self.reference,
            &mut self.p,
            &mut self.pv,
            &mut self.pvv,
            &mut self.pw,
            &mut self.pvw,
            &mut self.pww,
            &mut self.depth,
            &mut self.edge,
        ]
    }
}

impl Cells {
    /// Resizes the buffers; allocates only if the size has changed.
    pub fn resize(&mut self, width: usize, height: usize, cell_px: usize) {
        let (columns, rows) = (width.div_ceil(cell_px), height.div_ceil(cell_px));
        if (self.width, self.height, self.columns, self.rows) == (width, height, columns, rows) {
            return;
        }
        (self.width, self.height, self.columns, self.rows) = (width, height, columns, rows);
        self.cells.clear();
        self.cells.resize(columns * rows, Cell::default());
        for line in &mut self.lines {
            line.clear();
            line.resize(width + 2, 0.0);
        }
        for line in self.columns_of.all() {
            line.clear();
            line.resize(width, 0.0);
        }
    }

    /// Computes all cells. `left_out` has the size of the image; pixels with a non-zero entry are
    /// ignored. `jump` is that of [`DepthNormalConfig::jump`].
    pub fn fill(
        &mut self,
        config: &DepthNormalConfig,
        image: &DepthImage<'_>,
        left_out: Option<&[u8]>,
        jump: [f64; 2],
    ) {
        let (width, height, cell_px) = (self.width, self.height, config.cell_px);
        let range = config.range_m.map(|m| m as f32);
        let load = |line: &mut [f32], v: usize| {
            invert(image.row(v), range, &mut line[1..width + 1]);
            if let Some(mask) = left_out {
                for (w, out) in line[1..].iter_mut().zip(&mask[v * width..(v + 1) * width]) {
                    *w = if *out == 0 { *w } else { 0.0 };
                }
            }
        };
        let jump = jump.map(|x| x as f32);
        let floor = (config.depth_sd_m / config.inverse_depth_sd_per_m).powi(2) as f32;
        self.lines[0].fill(0.0);
        load(&mut self.lines[1], 0);
        for row in 0..self.rows {
            let (top, bottom) = (row * cell_px, ((row + 1) * cell_px).min(height));
            self.begin(image, range, top, bottom, cell_px);
            for v in top..bottom {
                if v + 1 < height {
                    load(&mut self.lines[2], v + 1);
                } else {
                    self.lines[2].fill(0.0);
                }
                let dv = (v - top) as f32 - 0.5 * (cell_px as f32 - 1.0);
                let [above, here, below] = &self.lines;
                self.columns_of.add(above, here, below, jump, floor, dv);
                self.lines.rotate_left(1);
            }
            self.end(row, cell_px);
        }
    }

    /// Clears the columns and chooses the reference of each cell's inverse depths: a reading near
    /// its middle.
    fn begin(
        &mut self,
        image: &DepthImage<'_>,
        range: [f32; 2],
        top: usize,
        bottom: usize,
        cell_px: usize,
    ) {
        for line in self.columns_of.all() {
            line.fill(0.0);
        }
        for left in (0..self.width).step_by(cell_px) {
            let right = (left + cell_px).min(self.width);
            let middle = (left + right) / 2;
            let rows = [(top + bottom) / 2, top, bottom - 1];
            let reading = rows.into_iter().find_map(|v| {
                let z = image.row(v)[middle];
                (z >= range[0] && z <= range[1]).then(|| 1.0 / z)
            });
            self.columns_of.reference[left..right].fill(reading.unwrap_or(0.0));
        }
    }

    /// Sums the columns to cells.
    fn end(&mut self, row: usize, cell_px: usize) {
        let scale = 1.0 / cell_px as f64;
        let c = &self.columns_of;
        for column in 0..self.columns {
            let left = column * cell_px;
            let right = (left + cell_px).min(self.width);
            let mut s = [0.0f32; 12];
            for i in left..right {
                let u = (i - left) as f32 - 0.5 * (cell_px as f32 - 1.0);
                let (p, pv, pw) = (c.p[i], c.pv[i], c.pw[i]);
                s[0] += p;
                s[1] += u * p;
                s[2] += pv;
                s[3] += u * u * p;
                s[4] += u * pv;
                s[5] += c.pvv[i];
                s[6] += pw;
                s[7] += u * pw;
                s[8] += c.pvw[i];
                s[9] += c.pww[i];
                s[10] += c.depth[i];
                s[11] += c.edge[i];
            }
            let cell = &mut self.cells[row * self.columns + column];
            let powers = [0, 1, 1, 2, 2, 2, 0, 1, 1, 0];
            for ((to, from), power) in cell.sums.iter_mut().zip(s).zip(powers) {
                *to = f64::from(from) * scale.powi(power);
            }
            cell.reference = f64::from(c.reference[left]);
            cell.depth = s[10] as u32;
            cell.edge = s[11] as u32;
        }
    }
}

/// Noise between neighbouring pixels along the rows, standard deviation, 1/m: from the median of
/// second differences over a sample of the image. 0 if there are too few pixels.
pub(super) fn noise_between_neighbours(
    image: &DepthImage<'_>,
    range_m: [f64; 2],
    differences: &mut Vec<f32>,
) -> f64 {
    let range = range_m.map(|m| m as f32);
    differences.clear();
    // About five thousand samples, whatever the image size.
    let every = (image.depth_m().len() / 5000).max(1);
    for i in (0..image.depth_m().len()).step_by(every) {
        let (u, v) = (i % image.width(), i / image.width());
        if u + 2 >= image.width() {
            continue;
        }
        let mut w = [0.0; 3];
        invert(&image.row(v)[u..u + 3], range, &mut w);
        if w.iter().all(|w| *w > 0.0) {
            differences.push((w[0] - 2.0 * w[1] + w[2]).abs());
        }
    }
    if differences.len() < 20 {
        return 0.0;
    }
    let middle = differences.len() / 2;
    let median = *differences.select_nth_unstable_by(middle, f32::total_cmp).1;
    // The median magnitude of a normal variable is 0.6745 standard deviations; the three pixels
    // have weights 1, -2 and 1, whose squares are 1, 4 and 1.
    f64::from(median) / (0.6745 * 6.0f64.sqrt())
}

fn invert(depth_m: &[f32], [near, far]: [f32; 2], w: &mut [f32]) {
    for (w, z) in w.iter_mut().zip(depth_m) {
        let inside = *z >= near && *z <= far;
        *w = if inside { 1.0 / *z } else { 0.0 };
    }
}

impl Columns {
    /// Adds one row. The lines have an empty pixel at either end; `dv` is the row's position in its
    /// cells.
    fn add(
        &mut self,
        above: &[f32],
        here: &[f32],
        below: &[f32],
        jump: [f32; 2],
        floor: f32,
        dv: f32,
    ) {
        let n = self.p.len();
        // Slices of equal length, so that the loop needs no bounds checks.
        let (above, below) = (&above[1..=n], &below[1..=n]);
        let (before, here, after) = (&here[..n], &here[1..=n], &here[2..n + 2]);
        let reference = &self.reference[..n];
        let (p, pv, pvv) = (&mut self.p[..n], &mut self.pv[..n], &mut self.pvv[..n]);
        let (pw, pvw, pww) = (&mut self.pw[..n], &mut self.pvw[..n], &mut self.pww[..n]);
        let (depth, edge) = (&mut self.depth[..n], &mut self.edge[..n]);
        for i in 0..n {
            let w = here[i];
            let step = |other: f32| if other > 0.0 { (w - other).abs() } else { 0.0 };
            let across = larger(step(before[i]), step(after[i]));
            let along = larger(step(above[i]), step(below[i]));
            let seen = if w > 0.0 { 1.0f32 } else { 0.0 };
            let apart = larger(across, along) > jump[0] + jump[1] * w;
            let lost = if apart { seen } else { 0.0 };
            let w2 = w * w;
            let weight = (seen - lost) / (1.0 + floor * w2 * w2);
            let d = (w - reference[i]) * weight;
            let weight_v = weight * dv;
            p[i] += weight;
            pv[i] += weight_v;
            pvv[i] += weight_v * dv;
            pw[i] += d;
            pvw[i] += d * dv;
            pww[i] += d * (w - reference[i]);
            depth[i] += seen;
            edge[i] += lost;
        }
    }
}

fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

const _: () = assert!(
    CELL_PX_MAX * CELL_PX_MAX < 1 << 24,
    "counts are exact in f32"
);
