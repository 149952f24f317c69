//! Fits a plane in inverse depth around every cell, over a window as large as the surface allows.
//!
//! For a plane, inverse depth is linear in the pixel's coordinates, so the weighted least-squares
//! plane over a rectangle of cells of any size follows from four corners of summed tables. A window
//! grows while the slopes of all sizes so far agree within their standard deviations (intersection
//! of confidence intervals): beyond that, the surface's curvature would bias the slope.

use super::cells::{Cell, Cells};
use super::config::DepthNormalConfig;

/// Number of sums in a table: those of a [`Cell`], and the number of edge cells.
const SUMS: usize = 11;
/// Reaches of the windows that are tried, cells.
const REACHES: [usize; 6] = [1, 2, 4, 8, 16, 64];

/// Plane at a cell's middle.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Node {
    /// Whether there is a plane.
    pub valid: bool,
    /// Inverse depth, 1/m.
    pub w: f64,
    /// Change of `w` per cell along `u` and `v`, 1/m.
    pub slope: [f64; 2],
    /// Covariance of the slope, `uu`, `uv`, `vv`, (1/m)².
    pub covariance: [f64; 3],
}

/// Noise measured in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameNoise {
    /// Variance of a pixel over the configured variance.
    pub scale: f64,
    /// Variance of averages over that of independent pixels: neighbours share part of their noise.
    pub correlation: f64,
}

impl Default for FrameNoise {
    fn default() -> Self {
        Self {
            scale: 1.0,
            correlation: 1.0,
        }
    }
}

impl FrameNoise {
    /// Variance of a pixel's inverse depth for use in averages, (1/m)².
    pub(super) fn variance(&self, config: &DepthNormalConfig) -> f64 {
        config.inverse_depth_sd_per_m.powi(2) * self.scale * self.correlation
    }
}

/// Summed tables, and the nodes computed from them.
#[derive(Clone, Debug, Default)]
pub(super) struct Windows {
    pub nodes: Vec<Node>,
    pub noise: FrameNoise,
    /// `(columns + 1) (rows + 1)` entries: sums over all cells above and to the left.
    table: Vec<[f64; SUMS]>,
    columns: usize,
    rows: usize,
    /// Middle of the grid, cells, and mean inverse depth: reference of the tables.
    origin: [f64; 3],
    ratios: Vec<f64>,
}

/// A plane over a window, at the mean of its points.
#[derive(Clone, Copy, Debug)]
struct Plane {
    middle: [f64; 3],
    slope: [f64; 2],
    /// Inverse of the points' spread: multiplied by the noise variance, it is the slope's
    /// covariance.
    inverse: [f64; 3],
    /// Weighted sum of squared residuals.
    rest: f64,
}

impl Plane {
    /// Plane from sums relative to any origin; `None` if the points lie on a line.
    fn of(s: &[f64; 10]) -> Option<Self> {
        let p = s[0];
        if p < 3.0 {
            return None;
        }
        let (u, v, w) = (s[1] / p, s[2] / p, s[6] / p);
        let (uu, uv, vv) = (s[3] - s[1] * u, s[4] - s[1] * v, s[5] - s[2] * v);
        let (uw, vw, ww) = (s[7] - s[6] * u, s[8] - s[6] * v, s[9] - s[6] * w);
        let determinant = uu * vv - uv * uv;
        // Compared with a spread of a hundredth of a cell.
        if determinant.is_nan() || determinant <= 1e-6 * p * p {
            return None;
        }
        let inverse = [vv / determinant, -uv / determinant, uu / determinant];
        let slope = [
            inverse[0] * uw + inverse[1] * vw,
            inverse[1] * uw + inverse[2] * vw,
        ];
        Some(Self {
            middle: [u, v, w],
            slope,
            inverse,
            rest: (ww - slope[0] * uw - slope[1] * vw).max(0.0),
        })
    }
}

impl Windows {
    pub fn resize(&mut self, columns: usize, rows: usize) {
        if (self.columns, self.rows) == (columns, rows) && !self.nodes.is_empty() {
            return;
        }
        (self.columns, self.rows) = (columns, rows);
        self.nodes.clear();
        self.nodes.resize(columns * rows, Node::default());
        self.table.clear();
        self.table.resize((columns + 1) * (rows + 1), [0.0; SUMS]);
        self.ratios.clear();
        self.ratios.reserve(2 * columns * rows);
    }

    /// Computes, from the smallest window, the node of every cell without an edge that has depth or
    /// neighbours with depth.
    pub fn begin(&mut self, config: &DepthNormalConfig, grid: &Cells) {
        self.sum(grid);
        self.measure_noise(config, grid);
        self.each(config, grid, 1, |_| true);
    }

    /// Finds the widest window for each node that is `wanted`.
    pub fn widen(
        &mut self,
        config: &DepthNormalConfig,
        grid: &Cells,
        wanted: impl Fn(usize) -> bool,
    ) {
        self.each(config, grid, config.window_cells_max, wanted);
    }

    fn each(
        &mut self,
        config: &DepthNormalConfig,
        grid: &Cells,
        reach_max: usize,
        wanted: impl Fn(usize) -> bool,
    ) {
        let variance = self.noise.variance(config);
        for row in 0..self.rows {
            for column in 0..self.columns {
                let i = row * self.columns + column;
                if !wanted(i) {
                    continue;
                }
                self.nodes[i] = if grid.cells[i].is_edge() {
                    Node::default()
                } else {
                    self.node(config, variance, reach_max, [column, row])
                };
            }
        }
    }

    fn sum(&mut self, grid: &Cells) {
        let (mut sum, mut weight) = (0.0, 0.0);
        for cell in &grid.cells {
            sum += cell.sums[6] + cell.reference * cell.sums[0];
            weight += cell.sums[0];
        }
        let middle = if weight > 0.0 { sum / weight } else { 0.0 };
        self.origin = [0.5 * self.columns as f64, 0.5 * self.rows as f64, middle];
        let stride = self.columns + 1;
        for row in 0..self.rows {
            let mut line = [0.0; SUMS];
            for column in 0..self.columns {
                let cell = &grid.cells[row * self.columns + column];
                let at = [column as f64 - self.origin[0], row as f64 - self.origin[1]];
                if cell.is_edge() {
                    line[10] += 1.0;
                } else {
                    for (sum, x) in line.iter_mut().zip(moved(cell, at, middle)) {
                        *sum += x;
                    }
                }
                let above = self.table[row * stride + column + 1];
                let here = &mut self.table[(row + 1) * stride + column + 1];
                for ((to, a), b) in here.iter_mut().zip(above).zip(line) {
                    *to = a + b;
                }
            }
        }
    }

    /// Sums over the cells `left..right`, `top..bottom`.
    fn window(&self, [left, right, top, bottom]: [usize; 4]) -> [f64; SUMS] {
        let stride = self.columns + 1;
        let (a, b) = (
            &self.table[top * stride + left],
            &self.table[top * stride + right],
        );
        let (c, d) = (
            &self.table[bottom * stride + left],
            &self.table[bottom * stride + right],
        );
        let mut sums = [0.0; SUMS];
        for i in 0..SUMS {
            sums[i] = d[i] - c[i] - b[i] + a[i];
        }
        sums
    }

    /// Measures the noise by medians over the cells: of the residuals of a plane within a cell, and
    /// of fourth differences between cells.
    fn measure_noise(&mut self, config: &DepthNormalConfig, grid: &Cells) {
        let full = (config.cell_px * config.cell_px) as f64;
        let expected = config.inverse_depth_sd_per_m.powi(2);
        self.ratios.clear();
        for row in 0..self.rows {
            for column in (row % 2..self.columns).step_by(2) {
                let cell = &grid.cells[row * self.columns + column];
                if cell.edge > 0 || f64::from(cell.depth) < 0.9 * full {
                    continue;
                }
                if let Some(plane) = Plane::of(&cell.sums) {
                    self.ratios
                        .push(plane.rest / ((f64::from(cell.depth) - 3.0) * expected));
                }
            }
        }
        let Some(scale) = median(&mut self.ratios) else {
            // Too little data: uses the configured noise.
            self.noise = FrameNoise::default();
            return;
        };
        // The depth of a camera without noise is still rounded.
        self.noise.scale = scale.clamp(1e-6, 1e4);
        self.ratios.clear();
        let stride = self.columns;
        for row in 0..self.rows {
            for column in (row % 2..self.columns).step_by(2) {
                let i = row * stride + column;
                let along = [
                    (column + 4 < self.columns).then_some(1),
                    (row + 4 < self.rows).then_some(stride),
                ];
                for step in along.into_iter().flatten() {
                    if let Some(ratio) = fourth_difference(&grid.cells, i, step, full) {
                        self.ratios.push(ratio / (self.noise.scale * expected));
                    }
                }
            }
        }
        // The median of a squared normal variable is 0.4549 of its variance.
        let ratio = median(&mut self.ratios).unwrap_or(0.4549) / 0.4549;
        // A cell is finite: the correlation with pixels beyond its border is missing.
        let cell = config.cell_px as f64;
        self.noise.correlation = (1.0 + (ratio - 1.0) * cell / (cell - 1.0)).clamp(1.0, 30.0);
    }

    fn node(
        &self,
        config: &DepthNormalConfig,
        variance: f64,
        reach_max: usize,
        [column, row]: [usize; 2],
    ) -> Node {
        let mut bounds = [column, column + 1, row, row + 1];
        let mut best: Option<(Plane, [usize; 4])> = None;
        if reach_max == 1 {
            // There is no wider window to compare with: accepted at once if it contains no edge.
            let around = [
                column.saturating_sub(1),
                (column + 2).min(self.columns),
                row.saturating_sub(1),
                (row + 2).min(self.rows),
            ];
            let sums = self.window(around);
            if sums[10] == 0.0 {
                let sums: &[f64; 10] = sums.first_chunk().expect("ten of eleven");
                return Plane::of(sums).map_or(Node::default(), |plane| {
                    self.node_of(&plane, variance, column, row)
                });
            }
        }
        let mut interval = [[f64::NEG_INFINITY, f64::INFINITY]; 2];
        let mut open = [true, true];
        let limits = [self.columns, self.rows];
        let place = [column, row];
        for reach in REACHES {
            let reach = reach.min(reach_max);
            for axis in 0..2 {
                if !open[axis] {
                    continue;
                }
                let from = place[axis].saturating_sub(reach);
                let to = (place[axis] + reach + 1).min(limits[axis]);
                let mut wider = bounds;
                (wider[2 * axis], wider[2 * axis + 1]) = (from, to);
                let mut sums = self.window(wider);
                if sums[10] > 0.0 {
                    // With an edge on one side, the window grows only on the other.
                    let mut one = bounds;
                    one[2 * axis] = from;
                    let mut other = bounds;
                    other[2 * axis + 1] = to;
                    let sides = [one, other].map(|b| (b, self.window(b)));
                    let Some((b, s)) = sides
                        .into_iter()
                        .find(|(b, s)| *b != bounds && s[10] == 0.0)
                    else {
                        open[axis] = false;
                        continue;
                    };
                    (wider, sums) = (b, s);
                }
                if wider == bounds && best.is_some() {
                    open[axis] = false;
                    continue;
                }
                let sums: &[f64; 10] = sums.first_chunk().expect("ten of eleven");
                let Some(plane) = Plane::of(sums) else {
                    bounds = wider;
                    continue;
                };
                let mut narrowed = interval;
                for (i, range) in narrowed.iter_mut().enumerate() {
                    let within = config.consistency_sd * (variance * plane.inverse[2 * i]).sqrt();
                    range[0] = range[0].max(plane.slope[i] - within);
                    range[1] = range[1].min(plane.slope[i] + within);
                }
                if narrowed.iter().any(|[low, high]| low > high) {
                    open[axis] = false;
                    continue;
                }
                interval = narrowed;
                bounds = wider;
                best = Some((plane, bounds));
            }
            if reach == reach_max || !(open[0] || open[1]) {
                break;
            }
        }
        let Some((plane, _)) = best else {
            return Node::default();
        };
        self.node_of(&plane, variance, column, row)
    }

    /// Value and slope of a plane at a cell's middle.
    fn node_of(&self, plane: &Plane, variance: f64, column: usize, row: usize) -> Node {
        let du = column as f64 - self.origin[0] - plane.middle[0];
        let dv = row as f64 - self.origin[1] - plane.middle[1];
        Node {
            valid: true,
            w: self.origin[2] + plane.middle[2] + plane.slope[0] * du + plane.slope[1] * dv,
            slope: plane.slope,
            covariance: plane.inverse.map(|x| x * variance),
        }
    }
}

/// Sums of a cell whose middle is at `at` (cells), with `w` relative to `origin`.
fn moved(cell: &Cell, [x, y]: [f64; 2], origin: f64) -> [f64; 10] {
    let [p, u, v, uu, uv, vv, w, uw, vw, ww] = cell.sums;
    let r = cell.reference - origin;
    let (wr, uwr, vwr) = (w + r * p, uw + r * u, vw + r * v);
    [
        p,
        u + x * p,
        v + y * p,
        uu + 2.0 * x * u + x * x * p,
        uv + x * v + y * u + x * y * p,
        vv + 2.0 * y * v + y * y * p,
        wr,
        uwr + x * wr,
        vwr + y * wr,
        ww + 2.0 * r * w + r * r * p,
    ]
}

/// Squared fourth difference of the means of five cells in a row, over its value for independent
/// pixels. Quadratics and cubics vanish in it. `None` unless all five cells are full.
fn fourth_difference(cells: &[Cell], first: usize, step: usize, full: f64) -> Option<f64> {
    let mut difference = 0.0;
    let mut variance = 0.0;
    for (k, factor) in [1.0, -4.0, 6.0, -4.0, 1.0].into_iter().enumerate() {
        let cell = cells.get(first + k * step)?;
        if cell.edge > 0 || f64::from(cell.depth) < 0.97 * full {
            return None;
        }
        difference += factor * cell.mean()?;
        variance += factor * factor / cell.sums[0];
    }
    Some(difference * difference / variance)
}

/// Median of at least 20 values.
fn median(values: &mut [f64]) -> Option<f64> {
    (values.len() >= 20).then(|| {
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    })
}
