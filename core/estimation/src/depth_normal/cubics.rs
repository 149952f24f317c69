//! Refines the slopes of the nodes by fitting cubics. The slope of a plane is off by the surface's
//! third derivative, that of a cubic by the fifth, so its window may be several times larger.
//!
//! On a complete rectangle of cells, the least-squares cubic is a fixed sum over the cells' means
//! (Savitzky and Golay), built from orthogonal polynomials along each axis. Its slope is that of
//! the plane plus two corrections, of `u³` and of `u v²`. A correction is used only as far as it
//! exceeds its noise, so that a plane remains a plane.

use super::cells::Cells;
use super::config::DepthNormalConfig;
use super::windows::Node;

/// Half widths of the rectangles that are tried, cells.
const REACHES: [usize; 7] = [2, 3, 4, 6, 8, 10, 12];

/// Coefficients that turn moments of the cells' means along one axis, `Σ kⁿ m` with `k` from
/// `-reach` to `reach`, into the terms of a cubic.
#[derive(Clone, Copy, Debug)]
struct Axis {
    reach: usize,
    /// One over the number of cells.
    share: f64,
    /// Slope of a straight line: coefficient of the first moment.
    line: f64,
    /// Correction of the slope by a cubic: coefficients of the third and the first moment.
    third: [f64; 2],
    /// Value of the second-order polynomial at the middle, over its norm: coefficients of the
    /// second moment and that of order zero.
    second: [f64; 2],
    /// Sums of the squared kernels of these three terms.
    squares: [f64; 3],
}

impl Axis {
    fn new(reach: usize) -> Self {
        let x = || (0..=2 * reach).map(|i| i as f64 - reach as f64);
        let moment = |power: i32| x().map(|x| x.powi(power)).sum::<f64>();
        let (m2, m4) = (moment(2), moment(4));
        let n = moment(0);
        // x² - m2/n, and x³ - x m4/m2: orthogonal to all polynomials of lower order.
        let (shift, slope3) = (m2 / n, m4 / m2);
        let norm2: f64 = x().map(|x| (x * x - shift).powi(2)).sum();
        let norm3: f64 = x().map(|x| (x * x * x - slope3 * x).powi(2)).sum();
        let third = if reach > 1 { -slope3 / norm3 } else { 0.0 };
        let second = -shift / norm2;
        Self {
            reach,
            share: 1.0 / n,
            line: 1.0 / m2,
            third: [third, -third * slope3],
            second: [second, -second * shift],
            squares: [1.0 / m2, third * third * norm3, second * second * norm2],
        }
    }
}

/// Kernels of the cubic fits, and the grid that they are applied to.
#[derive(Clone, Debug, Default)]
pub(super) struct Cubics {
    /// Coefficients for each of [`REACHES`].
    axes: Vec<Axis>,
    /// Variances of the slopes for unit noise of a cell: per reach along both axes and per slope,
    /// of the plane and of its two corrections.
    variances: [[[[f64; 3]; 2]; REACHES.len()]; REACHES.len()],
    /// Standard deviations of the slopes for unit noise of a cell: per reach along both axes and
    /// per slope.
    deviations: [[[f64; 2]; REACHES.len()]; REACHES.len()],
    /// For each of [`REACHES`] and each cell: sums along its row, with the coefficients of [`Axis`]
    /// and without.
    along_rows: Vec<Vec<[f64; 4]>>,
    /// Moments around each cell of one row, of orders zero to three.
    moments: [Vec<f64>; 4],
    /// Inverse depth at the middle of each cell, 1/m.
    means: Vec<f64>,
    /// Summed-area table, `(columns + 1) (rows + 1)`: number of cells above and to the left that
    /// have no mean, and that have one only from their neighbours.
    missing: Vec<[u32; 2]>,
    columns: usize,
    rows: usize,
    slopes: Vec<Option<Slope>>,
}

#[derive(Clone, Copy, Debug)]
struct Slope {
    slope: [f64; 2],
    covariance: [f64; 3],
}

/// Moments across the rows of a rectangle, of the sums in `Cubics::along_rows`. Rows are added in
/// pairs around the middle.
#[derive(Clone, Copy)]
struct Moments {
    /// Order zero, of the sums for `line` and `third`.
    zeroth: [f64; 2],
    /// Order one, of the sums for `second` and of those without coefficients.
    first: [f64; 2],
    /// Order two, of the sums for `line`.
    second: f64,
    /// Order three, of the sums without coefficients.
    third: f64,
}

/// Slopes of one rectangle along both axes: those of the plane, and their corrections.
struct Fit {
    plane: [f64; 2],
    corrections: [[f64; 2]; 2],
}

impl Fit {
    fn cubic(&self, axis: usize) -> f64 {
        self.plane[axis] + self.corrections[axis][0] + self.corrections[axis][1]
    }
}

impl Cubics {
    pub fn resize(&mut self, columns: usize, rows: usize) {
        if (self.columns, self.rows) == (columns, rows) && !self.axes.is_empty() {
            return;
        }
        (self.columns, self.rows) = (columns, rows);
        self.axes = REACHES.into_iter().map(Axis::new).collect();
        for x in 0..REACHES.len() {
            for y in 0..REACHES.len() {
                let [line_x, third_x, second_x] = self.axes[x].squares;
                let [line_y, third_y, second_y] = self.axes[y].squares;
                let [nx, ny] = [x, y].map(|i| (2 * REACHES[i] + 1) as f64);
                let variances = [
                    [line_x / ny, third_x / ny, line_x * second_y],
                    [line_y / nx, third_y / nx, line_y * second_x],
                ];
                self.variances[x][y] = variances;
                self.deviations[x][y] = variances.map(|v| v.iter().sum::<f64>().sqrt());
            }
        }
        self.along_rows = vec![vec![[0.0; 4]; columns * rows]; REACHES.len()];
        for line in &mut self.moments {
            line.clear();
            line.resize(columns, 0.0);
        }
        self.means.clear();
        self.means.resize(columns * rows, 0.0);
        self.missing.clear();
        self.missing.resize((columns + 1) * (rows + 1), [0; 2]);
        self.slopes.clear();
        self.slopes.resize(columns * rows, None);
    }

    /// Replaces the slopes of the nodes that have room for a cubic around them. `variance` is that
    /// of a pixel's inverse depth, correlation included.
    pub fn refine(
        &mut self,
        config: &DepthNormalConfig,
        grid: &Cells,
        variance: f64,
        nodes: &mut [Node],
    ) {
        let full = (config.cell_px * config.cell_px) as f64;
        self.take_means(grid, nodes, full);
        let limit = config.window_cells_max.max(REACHES[0]);
        let tried = REACHES.iter().take_while(|reach| **reach <= limit).count();
        self.sum_rows(tried);
        for row in 0..self.rows {
            for column in 0..self.columns {
                let i = row * self.columns + column;
                self.slopes[i] = if nodes[i].valid {
                    let per_cell = variance / full;
                    self.slope(config, per_cell, tried, column, row)
                } else {
                    None
                };
            }
        }
        for (node, slope) in nodes.iter_mut().zip(&self.slopes) {
            if let Some(found) = slope {
                node.slope = found.slope;
                node.covariance = found.covariance;
            }
        }
    }

    /// Whether [`Cubics::refine`] has replaced the slope of this node.
    pub fn has(&self, node: usize) -> bool {
        self.slopes[node].is_some()
    }

    fn take_means(&mut self, grid: &Cells, nodes: &[Node], full: f64) {
        let stride = self.columns + 1;
        for row in 0..self.rows {
            let mut line = [0; 2];
            for column in 0..self.columns {
                let i = row * self.columns + column;
                let (cell, node) = (&grid.cells[i], &nodes[i]);
                let whole = cell.sums[0] >= 0.3 * full && !cell.is_edge();
                match cell.mean() {
                    Some(mean) if whole => {
                        // Moves the value from the mean position of the cell's pixels to the cell's
                        // middle.
                        let p = cell.sums[0];
                        let along = node.slope[0] * cell.sums[1] + node.slope[1] * cell.sums[2];
                        self.means[i] = mean - along / p;
                    }
                    _ if node.valid => {
                        self.means[i] = node.w;
                        line[1] += 1;
                    }
                    _ => {
                        self.means[i] = 0.0;
                        line[0] += 1;
                    }
                }
                let above = self.missing[row * stride + column + 1];
                self.missing[(row + 1) * stride + column + 1] =
                    [above[0] + line[0], above[1] + line[1]];
            }
        }
    }

    /// Number of cells in a rectangle that have no mean, and that have one only from their
    /// neighbours; `None` if the rectangle exceeds the grid.
    fn missing(&self, column: usize, row: usize, [x, y]: [usize; 2]) -> Option<[u32; 2]> {
        if column < x || row < y || column + x >= self.columns || row + y >= self.rows {
            return None;
        }
        let stride = self.columns + 1;
        let corner = |c: usize, r: usize| self.missing[r * stride + c];
        let (left, right, top, bottom) = (column - x, column + x + 1, row - y, row + y + 1);
        let (a, b) = (corner(left, top), corner(right, top));
        let (c, d) = (corner(left, bottom), corner(right, bottom));
        Some([0, 1].map(|k| d[k] + a[k] - c[k] - b[k]))
    }

    /// Whether all cells of a rectangle have a mean, at most a tenth of them only from their
    /// neighbours.
    fn is_whole(&self, column: usize, row: usize, reach: [usize; 2]) -> bool {
        let [x, y] = reach.map(|i| REACHES[i]);
        self.missing(column, row, [x, y])
            .is_some_and(|[none, lent]| {
                none == 0 && (lent as usize) * 10 <= (2 * x + 1) * (2 * y + 1)
            })
    }

    /// Computes the sums along the rows for the first `tried` reaches. The moments of a reach are
    /// those of the reach before plus the added cells.
    fn sum_rows(&mut self, tried: usize) {
        let columns = self.columns;
        for row in 0..self.rows {
            let cells = row * columns..(row + 1) * columns;
            let means = &self.means[cells.clone()];
            let [m0, m1, m2, m3] = &mut self.moments;
            m0.copy_from_slice(means);
            for line in [&mut *m1, m2, m3] {
                line.fill(0.0);
            }
            let mut reached = 0;
            for (axis, sums) in self.axes.iter().zip(&mut self.along_rows).take(tried) {
                let reach = axis.reach;
                if 2 * reach + 1 > columns {
                    break;
                }
                for k in reached + 1..=reach {
                    let x = k as f64;
                    let (square, cube) = (x * x, x * x * x);
                    let n = columns - 2 * k;
                    let (before, after) = (&means[..n], &means[2 * k..]);
                    let [m0, m1] = [&mut *m0, m1].map(|line| &mut line[k..k + n]);
                    let [m2, m3] = [&mut *m2, m3].map(|line| &mut line[k..k + n]);
                    for i in 0..n {
                        let (sum, difference) = (after[i] + before[i], after[i] - before[i]);
                        m0[i] += sum;
                        m1[i] += x * difference;
                        m2[i] += square * sum;
                        m3[i] += cube * difference;
                    }
                }
                reached = reach;
                let n = columns - 2 * reach;
                let [m0, m1] = [&*m0, m1].map(|line| &line[reach..reach + n]);
                let [m2, m3] = [&*m2, m3].map(|line| &line[reach..reach + n]);
                let sums = &mut sums[cells.clone()][reach..reach + n];
                for i in 0..n {
                    sums[i] = [
                        axis.line * m1[i],
                        axis.third[0] * m3[i] + axis.third[1] * m1[i],
                        axis.second[0] * m2[i] + axis.second[1] * m0[i],
                        m0[i],
                    ];
                }
            }
        }
    }

    /// Moments of the middle row alone; `x` is the index of the reach along it in [`REACHES`].
    fn middle(&self, cell: usize, x: usize) -> Moments {
        let [line, third, _, _] = self.along_rows[x][cell];
        Moments {
            zeroth: [line, third],
            first: [0.0; 2],
            second: 0.0,
            third: 0.0,
        }
    }

    /// Adds to `m` the rows from `from` to `to` cells away from the middle row, on either side; `x`
    /// is the index of the reach along them in [`REACHES`].
    fn with_rows(&self, mut m: Moments, cell: usize, x: usize, from: usize, to: usize) -> Moments {
        let sums = &self.along_rows[x];
        for k in from..=to {
            let step = k * self.columns;
            let (above, below) = (&sums[cell - step], &sums[cell + step]);
            let y = k as f64;
            let even = [below[0] + above[0], below[1] + above[1]];
            let odd = [y * (below[2] - above[2]), y * (below[3] - above[3])];
            m.zeroth = [m.zeroth[0] + even[0], m.zeroth[1] + even[1]];
            m.first = [m.first[0] + odd[0], m.first[1] + odd[1]];
            m.second += y * y * even[0];
            m.third += y * y * odd[1];
        }
        m
    }

    /// Fit of a rectangle; `x` and `y` are the indices of its reaches in [`REACHES`].
    fn fit(&self, m: &Moments, [x, y]: [usize; 2]) -> Fit {
        let (across, along) = (&self.axes[x], &self.axes[y]);
        Fit {
            plane: [
                m.zeroth[0] * along.share,
                along.line * m.first[1] * across.share,
            ],
            corrections: [
                [
                    m.zeroth[1] * along.share,
                    along.second[0] * m.second + along.second[1] * m.zeroth[0],
                ],
                [
                    (along.third[0] * m.third + along.third[1] * m.first[1]) * across.share,
                    along.line * m.first[0],
                ],
            ],
        }
    }

    fn slope(
        &self,
        config: &DepthNormalConfig,
        per_cell: f64,
        tried: usize,
        column: usize,
        row: usize,
    ) -> Option<Slope> {
        let mut reach = [0, 0];
        if !self.is_whole(column, row, reach) {
            return None;
        }
        // If nothing is missing in the largest rectangle, no smaller one needs a check.
        let widest = REACHES[tried - 1];
        let all_there = self.missing(column, row, [widest, widest]) == Some([0, 0]);
        let deviation = config.consistency_sd * per_cell.sqrt();
        let narrowed = |interval: &[[f64; 2]; 2], fit: &Fit, reach: [usize; 2]| {
            let mut next = *interval;
            for (axis, range) in next.iter_mut().enumerate() {
                let within = deviation * self.deviations[reach[0]][reach[1]][axis];
                range[0] = range[0].max(fit.cubic(axis) - within);
                range[1] = range[1].min(fit.cubic(axis) + within);
            }
            next
        };
        let cell = row * self.columns + column;
        let mut moments = self.with_rows(self.middle(cell, 0), cell, 0, 1, REACHES[0]);
        let mut best = self.fit(&moments, reach);
        let mut interval = narrowed(&[[f64::NEG_INFINITY, f64::INFINITY]; 2], &best, reach);
        let mut open = [true, true];
        for wider in 1..tried {
            for axis in 0..2 {
                if !open[axis] {
                    continue;
                }
                let mut next = reach;
                next[axis] = wider;
                open[axis] = all_there || self.is_whole(column, row, next);
                if !open[axis] {
                    continue;
                }
                let [x, y] = next;
                let wider = if axis == 0 {
                    self.with_rows(self.middle(cell, x), cell, x, 1, REACHES[y])
                } else {
                    self.with_rows(moments, cell, x, REACHES[reach[1]] + 1, REACHES[y])
                };
                let fit = self.fit(&wider, next);
                let inside = narrowed(&interval, &fit, next);
                open[axis] = inside.iter().all(|[low, high]| low <= high);
                if open[axis] {
                    (interval, reach, best, moments) = (inside, next, fit, wider);
                }
            }
        }
        let variances = &self.variances[reach[0]][reach[1]];
        let slope = [0, 1].map(|axis| {
            let kept = [0, 1].map(|k| {
                let (t, v) = (best.corrections[axis][k], per_cell * variances[axis][k + 1]);
                // The part of a correction that exceeds its noise.
                if t * t > v {
                    t * (1.0 - v / (t * t))
                } else {
                    0.0
                }
            });
            best.plane[axis] + kept[0] + kept[1]
        });
        let total = |axis: usize| per_cell * variances[axis].iter().sum::<f64>();
        Some(Slope {
            slope,
            covariance: [total(0), 0.0, total(1)],
        })
    }
}
