//! The nodes' slopes once more, from cubics: a plane's slope is off by the surface's third derivative, a cubic's by the fifth, so
//! its window may be several times larger.
//!
//! On a whole rectangle of cells the least-squares cubic is a fixed sum over the cells' means (Savitzky and Golay), made of
//! orthogonal polynomials along either axis. Its slope is the plane's and two corrections, of `u³` and of `u v²`; what of them
//! does not stand out of the noise is left away, so that a plane stays one.

use super::cells::Cells;
use super::config::DepthNormalConfig;
use super::windows::Node;

/// Reach of the rectangles that are tried, cells.
const REACHES: [usize; 7] = [2, 3, 4, 6, 8, 10, 12];

/// Sums over cells along one axis, from the least cell to the last.
#[derive(Clone, Debug)]
struct Axis {
    /// Slope of a straight line.
    line: Vec<f64>,
    /// What a cubic adds to it.
    third: Vec<f64>,
    /// Value of the second polynomial in the middle, over its norm.
    second: Vec<f64>,
    /// Squares of the above, summed.
    squares: [f64; 3],
}

impl Axis {
    fn new(reach: usize) -> Self {
        let x: Vec<f64> = (0..=2 * reach).map(|i| i as f64 - reach as f64).collect();
        let n = x.len() as f64;
        let moment = |power: i32| x.iter().map(|x| x.powi(power)).sum::<f64>();
        let (m2, m4) = (moment(2), moment(4));
        let line: Vec<f64> = x.iter().map(|x| x / m2).collect();
        // x² - m2/n, and x³ - x m4/m2: orthogonal to all below.
        let shift = m2 / n;
        let p2: Vec<f64> = x.iter().map(|x| x * x - shift).collect();
        let norm2: f64 = p2.iter().map(|p| p * p).sum();
        let slope3 = m4 / m2;
        let p3: Vec<f64> = x.iter().map(|x| x * x * x - slope3 * x).collect();
        let norm3: f64 = p3.iter().map(|p| p * p).sum();
        let third: Vec<f64> = p3
            .iter()
            .map(|p| if reach > 1 { -slope3 * p / norm3 } else { 0.0 })
            .collect();
        let second: Vec<f64> = p2.iter().map(|p| -shift * p / norm2).collect();
        let squares = [&line, &third, &second].map(|k| k.iter().map(|k| k * k).sum());
        Self {
            line,
            third,
            second,
            squares,
        }
    }
}

/// The kernels and the grid they are laid over.
#[derive(Clone, Debug, Default)]
pub(super) struct Cubics {
    /// One for each of [`REACHES`].
    axes: Vec<Axis>,
    /// Variances of each rectangle's slopes for unit noise of a cell: along both axes, the plane's and its corrections'.
    variances: [[[[f64; 3]; 2]; REACHES.len()]; REACHES.len()],
    /// Their sums' square roots.
    deviations: [[[f64; 2]; REACHES.len()]; REACHES.len()],
    /// For each of them, cell by cell: sums along the row around the cell, as [`Axis`] has them, and without weights.
    along_rows: Vec<Vec<[f64; 4]>>,
    /// Inverse depth at the cells' middles, 1/m.
    means: Vec<f64>,
    /// `(columns + 1) (rows + 1)`: cells above and to the left that have no mean, and that have one only from their neighbours.
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

/// One rectangle's slopes along both axes: the plane's, its corrections, and their variances for unit noise of a cell.
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
        self.means.clear();
        self.means.resize(columns * rows, 0.0);
        self.missing.clear();
        self.missing.resize((columns + 1) * (rows + 1), [0; 2]);
        self.slopes.clear();
        self.slopes.resize(columns * rows, None);
    }

    /// Replaces the slopes of the nodes around which there is room for a cubic. `variance` is that of a pixel's inverse depth,
    /// correlation included.
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

    /// Whether [`Cubics::refine`] has found this node's slope.
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
                        // To the cell's middle, from where its pixels' mean is.
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

    /// Whether a rectangle has hardly any cell without a mean of its own.
    fn is_whole(&self, column: usize, row: usize, reach: [usize; 2]) -> bool {
        let [x, y] = reach.map(|i| REACHES[i]);
        if column < x || row < y || column + x >= self.columns || row + y >= self.rows {
            return false;
        }
        let stride = self.columns + 1;
        let corner = |c: usize, r: usize| self.missing[r * stride + c];
        let (left, right, top, bottom) = (column - x, column + x + 1, row - y, row + y + 1);
        let count = |k: usize| {
            corner(right, bottom)[k] + corner(left, top)[k]
                - corner(left, bottom)[k]
                - corner(right, top)[k]
        };
        count(0) == 0 && (count(1) as usize) * 10 <= (2 * x + 1) * (2 * y + 1)
    }

    /// The part along the rows of every rectangle's sums, for the first `tried` reaches.
    fn sum_rows(&mut self, tried: usize) {
        for ((axis, sums), reach) in self
            .axes
            .iter()
            .zip(&mut self.along_rows)
            .zip(REACHES)
            .take(tried)
        {
            if 2 * reach + 1 > self.columns {
                continue;
            }
            for row in 0..self.rows {
                let line = row * self.columns..(row + 1) * self.columns;
                let means = &self.means[line.clone()];
                let sums = &mut sums[line][reach..self.columns - reach];
                sums.fill([0.0; 4]);
                for i in 0..=2 * reach {
                    let [line, third, second] = [axis.line[i], axis.third[i], axis.second[i]];
                    for (s, m) in sums.iter_mut().zip(&means[i..]) {
                        s[0] += line * m;
                        s[1] += third * m;
                        s[2] += second * m;
                        s[3] += m;
                    }
                }
            }
        }
    }

    /// Of a rectangle with reaches by their number in [`REACHES`].
    fn fit(&self, column: usize, row: usize, [x, y]: [usize; 2]) -> Fit {
        let along = &self.axes[y];
        let (nx, ny) = ((2 * REACHES[x] + 1) as f64, (2 * REACHES[y] + 1) as f64);
        let mut plane = [0.0; 2];
        let mut corrections = [[0.0; 2]; 2];
        let first = (row - REACHES[y]) * self.columns + column;
        let sums = self.along_rows[x][first..].iter().step_by(self.columns);
        let kernels = along.line.iter().zip(&along.third).zip(&along.second);
        for ([line, third, second, sum], ((along_line, along_third), along_second)) in
            sums.zip(kernels)
        {
            plane[0] += line;
            corrections[0][0] += third;
            corrections[0][1] += line * along_second;
            plane[1] += along_line * sum;
            corrections[1][0] += along_third * sum;
            corrections[1][1] += along_line * second;
        }
        Fit {
            plane: [plane[0] / ny, plane[1] / nx],
            corrections: [
                [corrections[0][0] / ny, corrections[0][1]],
                [corrections[1][0] / nx, corrections[1][1]],
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
        let mut best = self.fit(column, row, reach);
        let mut interval = narrowed(&[[f64::NEG_INFINITY, f64::INFINITY]; 2], &best, reach);
        let mut open = [true, true];
        for wider in 1..tried {
            for axis in 0..2 {
                if !open[axis] {
                    continue;
                }
                let mut next = reach;
                next[axis] = wider;
                open[axis] = self.is_whole(column, row, next);
                if !open[axis] {
                    continue;
                }
                let fit = self.fit(column, row, next);
                let inside = narrowed(&interval, &fit, next);
                open[axis] = inside.iter().all(|[low, high]| low <= high);
                if open[axis] {
                    (interval, reach, best) = (inside, next, fit);
                }
            }
        }
        let variances = &self.variances[reach[0]][reach[1]];
        let slope = [0, 1].map(|axis| {
            let kept = [0, 1].map(|k| {
                let (t, v) = (best.corrections[axis][k], per_cell * variances[axis][k + 1]);
                // Of a correction, what stands out of its noise.
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
