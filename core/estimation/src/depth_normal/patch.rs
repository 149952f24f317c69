//! A cubic in inverse depth through the cells around a line of sight: the normal and curvature there, and how sure they are.
//!
//! The cubic's own terms are believed to be small, as small as surfaces are smooth: so what they may hide is in the covariance.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::cells::Cells;
use super::config::DepthNormalConfig;
use super::facets::{Facet, Mesh};
use super::inverse_depth::InverseDepth;
use super::windows::FrameNoise;

/// 1, x, y, xx, xy, yy, xxx, xxy, xyy, yyy.
const TERMS: usize = 10;

/// What a patch is fitted to.
pub(super) struct Ground<'a> {
    pub config: &'a DepthNormalConfig,
    pub cells: &'a Cells,
    pub facets: &'a [Facet],
    /// Which body each cell belongs to.
    pub body: &'a [u16],
    pub mesh: Mesh,
    pub noise: FrameNoise,
}

/// Why there is no patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PatchError {
    TooFew,
    OneSided,
}

/// The fit at one line of sight.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    pub at: InverseDepth,
    /// Of `[w, w_a, w_b]`.
    pub covariance: Matrix3<f64>,
    /// Of `[w_aa, w_ab, w_bb]`.
    pub bend_covariance: Matrix3<f64>,
    /// Reach of the cells that were used, m.
    pub radius_m: f64,
    pub cells: usize,
}

impl Ground<'_> {
    /// The widest patch of the body at `sight` (about `depth_m` away) whose slopes agree with those of the narrower ones.
    pub fn widest(&self, sight: [f64; 2], depth_m: f64, body: u16) -> Result<Patch, PatchError> {
        let [small, large] = self.config.patch_radius_m;
        let mut best: Result<Patch, PatchError> = Err(PatchError::TooFew);
        let mut interval = [[f64::NEG_INFINITY, f64::INFINITY]; 2];
        let mut radius = small;
        loop {
            match self.patch(sight, depth_m, body, radius) {
                Ok(patch) => {
                    for (i, range) in interval.iter_mut().enumerate() {
                        let sd = patch.covariance[(i + 1, i + 1)].sqrt();
                        let within = self.config.consistency_sd * sd;
                        range[0] = range[0].max(patch.at.slope[i] - within);
                        range[1] = range[1].min(patch.at.slope[i] + within);
                    }
                    if interval.iter().any(|[low, high]| low > high) {
                        break;
                    }
                    best = Ok(patch);
                }
                Err(error) if best.is_err() => best = Err(error),
                Err(_) => {}
            }
            if radius >= large {
                break;
            }
            radius = (radius * 1.3).min(large);
        }
        best
    }

    /// The patch within `radius_m`.
    pub fn patch(
        &self,
        sight: [f64; 2],
        depth_m: f64,
        body: u16,
        radius_m: f64,
    ) -> Result<Patch, PatchError> {
        let [column, row] = self.mesh.place(sight);
        let reach = self
            .mesh
            .step
            .map(|step| (radius_m / (depth_m * step)).min(1e4));
        let around = |middle: f64, reach: f64, size: usize| {
            let from = (middle - reach).ceil().max(0.0) as usize;
            let to = ((middle + reach).floor() + 1.0).max(0.0) as usize;
            from..to.min(size)
        };
        // Coordinates over the reach, so that the matrix is well scaled.
        let scale = reach[0].max(reach[1]).max(1e-9);
        let mut matrix = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SVector::<f64, TERMS>::zeros();
        let centre = Vector3::new(sight[0], sight[1], 1.0) * depth_m;
        let mut square = 0.0;
        let mut used = 0usize;
        let mut octants = 0u8;
        let reference = 1.0 / depth_m;
        for j in around(row, reach[1], self.cells.rows) {
            for i in around(column, reach[0], self.cells.columns) {
                let k = j * self.cells.columns + i;
                if self.body[k] != body || !self.facets[k].valid {
                    continue;
                }
                let (x, y) = ((i as f64 - column) / scale, (j as f64 - row) / scale);
                let flat = [(i as f64 - column) / reach[0], (j as f64 - row) / reach[1]];
                if flat[0] * flat[0] + flat[1] * flat[1] > 1.0
                    || (self.facets[k].point - centre).norm() > 1.5 * radius_m
                {
                    continue;
                }
                let cell = &self.cells.cells[k];
                let sums = &cell.sums;
                let (p, c) = (sums[0], 1.0 / scale);
                // A hole has a facet from its neighbours, but nothing to say.
                if p <= 0.0 {
                    continue;
                }
                let (u, v) = (sums[1] / p, sums[2] / p);
                let (uu, uv, vv) = (
                    (sums[3] / p - u * u) * c * c,
                    (sums[4] / p - u * v) * c * c,
                    (sums[5] / p - v * v) * c * c,
                );
                let (x, y) = (x + u * c, y + v * c);
                // Means over the cell's pixels; what is lopsided within a cell does not count.
                let line = SVector::<f64, TERMS>::from([
                    1.0,
                    x,
                    y,
                    x * x + uu,
                    x * y + uv,
                    y * y + vv,
                    x * x * x + 3.0 * x * uu,
                    x * x * y + y * uu + 2.0 * x * uv,
                    x * y * y + x * vv + 2.0 * y * uv,
                    y * y * y + 3.0 * y * vv,
                ]);
                let w = cell.reference + sums[6] / p - reference;
                matrix.syger(p, &line, &line, 1.0);
                right.axpy(p * w, &line, 1.0);
                square += p * w * w;
                used += 1;
                octants |= 1 << octant(x, y);
            }
        }
        if used < self.config.patch_cells_min {
            return Err(PatchError::TooFew);
        }
        if longest_gap(octants) >= 4 {
            return Err(PatchError::OneSided);
        }
        let pixel = self.config.inverse_depth_sd_per_m.powi(2) * self.noise.scale;
        let expected = pixel * self.noise.correlation;
        // A third derivative of depth, 1/m², is one of inverse depth by the line of sight, 1/m, times the depth.
        let [step_a, step_b] = self.mesh.step.map(|s| s * scale);
        let third = self.config.bend_change_sd_per_m2 * depth_m;
        let believed = [
            third * step_a.powi(3) / 6.0,
            third * step_a.powi(2) * step_b / 2.0,
            third * step_a * step_b.powi(2) / 2.0,
            third * step_b.powi(3) / 6.0,
        ];
        for (i, sd) in believed.into_iter().enumerate() {
            matrix[(6 + i, 6 + i)] += expected / (sd * sd).max(1e-30);
        }
        matrix.fill_upper_triangle_with_lower_triangle();
        let cholesky = matrix.cholesky().ok_or(PatchError::TooFew)?;
        let solution = cholesky.solve(&right);
        let rest = (square - right.dot(&solution)).max(0.0);
        // What the cells themselves show counts where it is more.
        let shown = rest / (used as f64 - 6.0).max(1.0);
        let mut covariance = cholesky.inverse() * expected.max(shown);
        // From the scaled coordinates to derivatives by the line of sight.
        let (by_a, by_b) = (1.0 / step_a, 1.0 / step_b);
        let by = SVector::<f64, 6>::from([
            1.0,
            by_a,
            by_b,
            2.0 * by_a * by_a,
            by_a * by_b,
            2.0 * by_b * by_b,
        ]);
        let found = solution.fixed_rows::<6>(0).component_mul(&by);
        let mut covariance = covariance.fixed_view_mut::<6, 6>(0, 0);
        covariance.component_mul_assign(&(by * by.transpose()));
        Ok(Patch {
            at: InverseDepth {
                sight,
                w: reference + found[0],
                slope: [found[1], found[2]],
                bend: [found[3], found[4], found[5]],
            },
            covariance: covariance.fixed_view::<3, 3>(0, 0).into(),
            bend_covariance: covariance.fixed_view::<3, 3>(3, 3).into(),
            radius_m,
            cells: used,
        })
    }
}

fn octant(x: f64, y: f64) -> u8 {
    u8::from(x >= 0.0) | u8::from(y >= 0.0) << 1 | u8::from(x.abs() > y.abs()) << 2
}

/// Longest run of empty octants around the middle, of eight.
fn longest_gap(octants: u8) -> u32 {
    // Counter-clockwise in the image.
    let order = [0b111, 0b011, 0b010, 0b110, 0b100, 0b000, 0b001, 0b101];
    let mut ring = 0u16;
    for (i, octant) in order.into_iter().enumerate() {
        if octants & (1 << octant) == 0 {
            ring |= 0x101 << i;
        }
    }
    let (mut longest, mut run) = (0, 0);
    for i in 0..16 {
        run = if ring & (1 << i) != 0 { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    longest.min(8)
}
