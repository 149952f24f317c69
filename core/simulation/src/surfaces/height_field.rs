//! A table of heights from CSV text, interpolated by a uniform bicubic spline. It is twice
//! differentiable, so its curvature exists.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::graph::{self, Graph};
use super::ray::{self, Ray};
use super::shape::Shape;

/// Error in a table of heights.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HeightFieldError {
    /// A cell is not a number.
    #[error("line {line}, column {column}: `{text}` is not a finite number of metres")]
    NotANumber {
        /// Line, counted from 1.
        line: usize,
        /// Column, counted from 1.
        column: usize,
        /// Text of the cell.
        text: String,
    },
    /// The length of a row differs from that of the first row.
    #[error(
        "line {line} has {got} cells, but {want} are needed (one coordinate, then one height per column)"
    )]
    Ragged {
        /// Line, counted from 1.
        line: usize,
        /// Number of cells found.
        got: usize,
        /// Number of cells needed.
        want: usize,
    },
    /// There are too few rows or columns for a cubic.
    #[error(
        "the table has {columns} columns and {rows} rows of heights; at least 4 of each are needed"
    )]
    TooSmall {
        /// Number of columns of heights.
        columns: usize,
        /// Number of rows of heights.
        rows: usize,
    },
    /// The coordinates do not increase by one constant step.
    #[error(
        "{axis} coordinates must increase by one constant step (m), but number {index} is {value} where {expected} was expected"
    )]
    NotUniform {
        /// Axis, `x` or `y`.
        axis: char,
        /// Number of the coordinate, counted from 1.
        index: usize,
        /// Coordinate found, m.
        value: f64,
        /// Coordinate expected for a constant step, m.
        expected: f64,
    },
}

/// `z = h(x, y)` from a regular table, continued beyond the border by the tangent plane there.
#[derive(Clone, Debug)]
pub struct HeightField {
    origin: [f64; 2],
    step: [f64; 2],
    /// Number of columns and rows of heights.
    size: [usize; 2],
    /// Spline coefficients with one more on every side, row by row.
    coefficients: Vec<f64>,
    /// Upper bound of the gradient's norm: a spline's slope is an average of the differences of its
    /// coefficients.
    slope_max: f64,
    /// Upper bound of the second derivatives' norm, 1/m: that of the second differences.
    curvature_max: f64,
    /// Lowest and highest coefficient, m: a spline lies between those of its coefficients.
    range: [f64; 2],
}

impl HeightField {
    /// Reads a table. First row: an ignored cell, then the x coordinates. Further rows: y, then
    /// heights. All are in m; empty lines and lines that start with `#` are skipped.
    ///
    /// # Errors
    /// The table is malformed; the error names the line, the text and what is allowed.
    ///
    /// ```
    /// use nalgebra::Vector3;
    /// use tangent_simulation::surfaces::{HeightField, Shape};
    ///
    /// // A table of 0.15 m by 0.15 m, flat at a height of 10 mm.
    /// let mut text = ",0.0,0.05,0.1,0.15\n".to_owned();
    /// for y in ["0.0", "0.05", "0.1", "0.15"] {
    ///     text += &format!("{y},0.01,0.01,0.01,0.01\n");
    /// }
    /// let flat = HeightField::from_csv(&text)?;
    /// let (distance, normal) = flat.distance_and_normal(&Vector3::new(0.05, 0.05, 0.03));
    /// assert!((distance - 0.02).abs() < 1e-9);
    /// assert!((normal - Vector3::z()).norm() < 1e-9);
    /// # Ok::<(), tangent_simulation::surfaces::HeightFieldError>(())
    /// ```
    pub fn from_csv(text: &str) -> Result<Self, HeightFieldError> {
        let mut lines = text
            .lines()
            .enumerate()
            .map(|(i, line)| (i + 1, line.trim()))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let too_small = HeightFieldError::TooSmall {
            columns: 0,
            rows: 0,
        };
        let (first_line, header) = lines.next().ok_or(too_small)?;
        let mut x = Vec::new();
        for (column, cell) in header.split(',').enumerate().skip(1) {
            x.push(number(cell, first_line, column + 1)?);
        }
        let (mut y, mut heights) = (Vec::new(), Vec::new());
        for (line, row) in lines {
            let got = row.split(',').count();
            if got != x.len() + 1 {
                return Err(HeightFieldError::Ragged {
                    line,
                    got,
                    want: x.len() + 1,
                });
            }
            for (column, cell) in row.split(',').enumerate() {
                let value = number(cell, line, column + 1)?;
                if column == 0 {
                    y.push(value)
                } else {
                    heights.push(value)
                }
            }
        }
        if x.len() < 4 || y.len() < 4 {
            return Err(HeightFieldError::TooSmall {
                columns: x.len(),
                rows: y.len(),
            });
        }
        let step = [uniform_step('x', &x)?, uniform_step('y', &y)?];
        let (nx, ny) = (x.len(), y.len());

        // Interpolating coefficients: first along every row, then along every column.
        let mut rows = vec![0.0; (nx + 2) * ny];
        for j in 0..ny {
            let line = spline_coefficients(&heights[j * nx..(j + 1) * nx]);
            rows[j * (nx + 2)..(j + 1) * (nx + 2)].copy_from_slice(&line);
        }
        let mut coefficients = vec![0.0; (nx + 2) * (ny + 2)];
        for i in 0..nx + 2 {
            let column: Vec<f64> = (0..ny).map(|j| rows[j * (nx + 2) + i]).collect();
            for (j, c) in spline_coefficients(&column).into_iter().enumerate() {
                coefficients[j * (nx + 2) + i] = c;
            }
        }
        let steepest = |stride: usize, step: f64| {
            let pairs = coefficients.iter().zip(coefficients.iter().skip(stride));
            let differences = pairs
                .enumerate()
                .filter(|(i, _)| stride > 1 || (i + 1) % (nx + 2) != 0);
            differences.fold(0.0, |most: f64, (_, (a, b))| most.max((b - a).abs())) / step
        };
        let (along_x, along_y) = (steepest(1, step[0]), steepest(nx + 2, step[1]));
        let bend = |stride: usize, step: f64| {
            let inner = coefficients.len().saturating_sub(2 * stride);
            let second = |i: usize| {
                coefficients[i] - 2.0 * coefficients[i + stride] + coefficients[i + 2 * stride]
            };
            let same_row = |i: &usize| stride > 1 || i % (nx + 2) < nx;
            let all = (0..inner).filter(same_row).map(second);
            all.fold(0.0, |most: f64, d| most.max(d.abs())) / (step * step)
        };
        Ok(Self {
            // The mixed derivative is bounded by the two others for the surfaces of tables that
            // are sampled finely enough.
            curvature_max: 2.0 * bend(1, step[0]).max(bend(nx + 2, step[1])),
            range: [
                coefficients.iter().copied().fold(f64::INFINITY, f64::min),
                coefficients
                    .iter()
                    .copied()
                    .fold(f64::NEG_INFINITY, f64::max),
            ],
            slope_max: (along_x * along_x + along_y * along_y).sqrt(),
            origin: [x[0], y[0]],
            step,
            size: [nx, ny],
            coefficients,
        })
    }

    /// Index of the interval, and the four cubic weights with their first and second derivatives
    /// per unit of the step.
    fn weights(&self, axis: usize, coordinate: f64) -> (usize, [[f64; 4]; 3], f64) {
        let last = (self.size[axis] - 1) as f64;
        let u = (coordinate - self.origin[axis]) / self.step[axis];
        let inside = u.clamp(0.0, last);
        let i = (inside as usize).min(self.size[axis] - 2);
        let t = inside - i as f64;
        let s = 1.0 - t;
        let (t2, t3) = (t * t, t * t * t);
        let value = [
            s * s * s / 6.0,
            (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0,
            (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0,
            t3 / 6.0,
        ];
        let first = [
            -s * s / 2.0,
            (3.0 * t2 - 4.0 * t) / 2.0,
            (-3.0 * t2 + 2.0 * t + 1.0) / 2.0,
            t2 / 2.0,
        ];
        let second = [s, 3.0 * t - 2.0, 1.0 - 3.0 * t, t];
        (i, [value, first, second], (u - inside) * self.step[axis])
    }
}

impl Graph for HeightField {
    fn height(&self, x: f64, y: f64) -> (f64, Vector2<f64>, Matrix2<f64>) {
        let (i, wx, beyond_x) = self.weights(0, x);
        let (j, wy, beyond_y) = self.weights(1, y);
        let stride = self.size[0] + 2;
        let mut sums = [[0.0; 3]; 3];
        for (b, row) in (j..j + 4).enumerate() {
            let c = &self.coefficients[row * stride + i..row * stride + i + 4];
            for (dx, weights) in wx.iter().enumerate() {
                let along =
                    weights[0] * c[0] + weights[1] * c[1] + weights[2] * c[2] + weights[3] * c[3];
                for (dy, weights_y) in wy.iter().enumerate().take(3 - dx) {
                    sums[dx][dy] += along * weights_y[b];
                }
            }
        }
        let [sx, sy] = self.step;
        let gradient = Vector2::new(sums[1][0] / sx, sums[0][1] / sy);
        let mixed = sums[1][1] / (sx * sy);
        // Beyond the border the surface continues straight across it, without curvature.
        let outside = beyond_x != 0.0 || beyond_y != 0.0;
        let hessian = if outside {
            Matrix2::zeros()
        } else {
            Matrix2::new(sums[2][0] / (sx * sx), mixed, mixed, sums[0][2] / (sy * sy))
        };
        let height = sums[0][0] + gradient.x * beyond_x + gradient.y * beyond_y;
        (height, gradient, hessian)
    }

    fn slope_max(&self) -> f64 {
        self.slope_max
    }

    fn curvature_max(&self) -> f64 {
        self.curvature_max
    }

    fn detail_m(&self) -> f64 {
        0.5 * self.step[0].min(self.step[1])
    }

    /// Beyond its border, where the surface continues along its tangent plane, this is not a
    /// bound.
    fn height_range(&self) -> [f64; 2] {
        self.range
    }
}

impl Shape for HeightField {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        graph::distance_and_normal(self, point)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        graph::curvature(self, point)
    }

    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        ray::march_graph(self, ray, range)
    }
}

fn number(cell: &str, line: usize, column: usize) -> Result<f64, HeightFieldError> {
    let value: Option<f64> = cell.trim().parse().ok().filter(|v: &f64| v.is_finite());
    value.ok_or_else(|| HeightFieldError::NotANumber {
        line,
        column,
        text: cell.trim().to_owned(),
    })
}

fn uniform_step(axis: char, values: &[f64]) -> Result<f64, HeightFieldError> {
    let step = (values[values.len() - 1] - values[0]) / (values.len() - 1) as f64;
    for (index, &value) in values.iter().enumerate() {
        let expected = values[0] + step * index as f64;
        if step <= 0.0 || (value - expected).abs() > 1e-6 * step {
            return Err(HeightFieldError::NotUniform {
                axis,
                index: index + 1,
                value,
                expected,
            });
        }
    }
    Ok(step)
}

/// Uniform cubic B-spline coefficients (two more than values) that interpolate `values`, with
/// natural ends.
fn spline_coefficients(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let mut c = vec![0.0; n + 2];
    // Natural ends make the end coefficients equal to the end values; between them a tridiagonal
    // system (1, 4, 1).
    c[1] = values[0];
    c[n] = values[n - 1];
    let inner = n - 2;
    let (mut upper, mut right) = (vec![0.0; inner], vec![0.0; inner]);
    for k in 0..inner {
        let mut b = 6.0 * values[k + 1];
        if k == 0 {
            b -= c[1];
        }
        if k == inner - 1 {
            b -= c[n];
        }
        let (above, before) = if k == 0 {
            (0.0, 0.0)
        } else {
            (upper[k - 1], right[k - 1])
        };
        let pivot = 4.0 - above;
        upper[k] = 1.0 / pivot;
        right[k] = (b - before) / pivot;
    }
    for k in (0..inner).rev() {
        let next = if k == inner - 1 {
            0.0
        } else {
            upper[k] * c[k + 3]
        };
        c[k + 2] = right[k] - next;
    }
    c[0] = 2.0 * c[1] - c[2];
    c[n + 1] = 2.0 * c[n] - c[n - 1];
    c
}
