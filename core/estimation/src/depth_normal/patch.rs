//! Fits a cubic to the cells around a point, as height over the tangent plane there. It gives
//! normal and curvature with their covariances.
//!
//! In the tangent frame, the third derivative of a curved surface is only the change of its
//! curvature, however obliquely the surface is seen. The fit assumes a smooth surface, for which
//! this change is small; the error that it may hide is part of the covariance.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::cells::Cells;
use super::config::DepthNormalConfig;
use super::facets::{Facet, Mesh};
use super::windows::FrameNoise;
use crate::tangent_frame::TangentFrame;

/// Number of terms: 1, x, y, xx, xy, yy, xxx, xxy, xyy, yyy.
const TERMS: usize = 10;
/// Length over which the rate of change of a surface's curvature varies, m: a wave of 0.4 m.
const CHANGE_LENGTH_M: f64 = 0.06;
/// Search radius over the largest radius, if too little is visible within the largest.
const FURTHEST: f64 = 2.0;
/// Ratio of successive radii that are tried.
const GROWTH: f64 = 1.25;

/// Data that a patch is fitted to.
pub(super) struct Ground<'a> {
    pub config: &'a DepthNormalConfig,
    pub cells: &'a Cells,
    pub facets: &'a [Facet],
    /// Connected component of each cell.
    pub body: &'a [u16],
    pub mesh: Mesh,
    pub noise: FrameNoise,
}

/// Reason why there is no patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PatchError {
    TooFew,
    OneSided,
}

/// Position of a patch: a point near the surface, and the approximate normal there; camera axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub point: Vector3<f64>,
    pub normal: Vector3<f64>,
    /// Expected shape operator, 1/m; used only for the fourth order of the height.
    pub shape: Matrix3<f64>,
}

/// Result of the fit, camera axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// Point on the surface directly below the requested place.
    pub place: Place,
    pub frame: TangentFrame,
    /// Covariance of the normal, rad², tangent axes.
    pub covariance: Matrix2<f64>,
    /// Shape operator, 1/m, tangent axes.
    pub shape: Matrix2<f64>,
    /// Covariance of the shape operator's `xx`, `xy`, `yy`, 1/m².
    pub shape_covariance: Matrix3<f64>,
    /// Largest distance of the cells used, m.
    pub radius_m: f64,
    pub cells: usize,
}

impl Ground<'_> {
    /// The widest patch of the connected component whose slopes agree with those of the narrower
    /// patches, fitted again in its own tangent frame under `ray`.
    pub fn widest(&self, place: &Place, ray: [f64; 2], body: u16) -> Result<Patch, PatchError> {
        let [small, large] = self.config.patch_radius_m;
        let frame = TangentFrame::new(place.normal, Vector3::x());
        let mut best = Err(PatchError::TooFew);
        let mut interval = [[f64::NEG_INFINITY, f64::INFINITY]; 2];
        let mut radius = small;
        let mut place = *place;
        loop {
            match self.patch(&place, body, radius) {
                Ok(patch) => {
                    place.shape = patch.place.shape;
                    let turn = frame.project(&patch.frame.normal);
                    for (i, range) in interval.iter_mut().enumerate() {
                        let within =
                            self.config.patch_consistency_sd * patch.covariance[(i, i)].sqrt();
                        range[0] = range[0].max(turn[i] - within);
                        range[1] = range[1].min(turn[i] + within);
                    }
                    if interval.iter().any(|[low, high]| low > high) {
                        break;
                    }
                    best = Ok(patch);
                }
                Err(error) if best.is_err() => best = Err(error),
                Err(_) => {}
            }
            // If too little is visible, around the tool or its shadow, cells further away may be
            // used.
            let limit = if best.is_err() {
                FURTHEST * large
            } else {
                large
            };
            if radius >= limit {
                break;
            }
            radius = (radius * GROWTH).min(limit);
        }
        let found = best?;
        let [a, b] = ray;
        let direction = Vector3::new(a, b, 1.0);
        let normal = found.frame.normal;
        let depth = found.place.point.dot(&normal) / direction.dot(&normal);
        if !(depth.is_finite() && depth > 0.0) {
            return Err(PatchError::TooFew);
        }
        let there = Place {
            point: direction * depth,
            ..found.place
        };
        self.patch(&there, body, found.radius_m).or(Ok(found))
    }

    /// The patch within `radius_m`.
    pub fn patch(&self, place: &Place, body: u16, radius_m: f64) -> Result<Patch, PatchError> {
        let frame = TangentFrame::new(place.normal, Vector3::x());
        let depth = place.point.z.max(1e-3);
        let [column, row] = self
            .mesh
            .place([place.point.x / depth, place.point.y / depth]);
        // A radius towards the camera appears larger.
        let near = (depth - radius_m).max(0.5 * depth);
        let reach = self
            .mesh
            .step
            .map(|step| (radius_m / (near * step) + 1.0).min(1e4));
        let around = |middle: f64, reach: f64, size: usize| {
            let from = (middle - reach).ceil().max(0.0) as usize;
            let to = ((middle + reach).floor() + 1.0).max(0.0) as usize;
            from..to.min(size)
        };
        let mut matrix = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SVector::<f64, TERMS>::zeros();
        let mut square = 0.0;
        let bent = frame.project_matrix(&place.shape);
        let mut used = 0usize;
        let mut octants = 0u8;
        let pixel = self.config.inverse_depth_sd_per_m.powi(2) * self.noise.scale;
        let expected = pixel * self.noise.correlation;
        for j in around(row, reach[1], self.cells.rows) {
            for i in around(column, reach[0], self.cells.columns) {
                let k = j * self.cells.columns + i;
                let sums = &self.cells.cells[k].sums;
                // A hole has a facet from its neighbours, but no data of its own.
                if self.body[k] != body || !self.facets[k].valid || sums[0] <= 0.0 {
                    continue;
                }
                let p = sums[0];
                let w = self.cells.cells[k].reference + sums[6] / p;
                let [a, b] = self
                    .mesh
                    .ray(i as f64 + sums[1] / p, j as f64 + sums[2] / p);
                let direction = Vector3::new(a, b, 1.0);
                let offset = direction / w - place.point;
                // Divided by the radius, so that the matrix is well scaled.
                let xy = frame.project(&offset) / radius_m;
                let height = frame.normal.dot(&offset);
                if xy.norm_squared() > 1.0 || height.abs() > radius_m {
                    continue;
                }
                let (x, y) = (xy.x, xy.y);
                // Higher-order height of a surface with this curvature along its whole length.
                let turn = bent * xy;
                let height =
                    height + 0.125 * radius_m.powi(4) * xy.dot(&turn) * turn.norm_squared();
                let line = SVector::<f64, TERMS>::from([
                    1.0,
                    x,
                    y,
                    x * x,
                    x * y,
                    y * y,
                    x * x * x,
                    x * x * y,
                    x * y * y,
                    y * y * y,
                ]);
                // Noise acts along the ray; this is its component in the height.
                let along = frame.normal.dot(&direction) / (w * w);
                let information = p / (expected * along * along).max(1e-30);
                matrix.syger(information, &line, &line, 1.0);
                right.axpy(information * height, &line, 1.0);
                square += information * height * height;
                used += 1;
                octants |= 1 << octant(x, y);
            }
        }
        if used > 2 && longest_gap(octants) >= 4 {
            return Err(PatchError::OneSided);
        }
        if used < self.config.patch_cells_min {
            return Err(PatchError::TooFew);
        }
        let change = self.config.bend_change_sd_per_m2 * radius_m.powi(3);
        for (i, share) in [6.0, 2.0, 2.0, 6.0].into_iter().enumerate() {
            matrix[(6 + i, 6 + i)] += (share / change).powi(2);
        }
        matrix.fill_upper_triangle_with_lower_triangle();
        let cholesky = matrix.cholesky().ok_or(PatchError::TooFew)?;
        let solution = cholesky.solve(&right);
        // The residuals of the cells replace the stated noise if they are larger.
        let rest = (square - right.dot(&solution)).max(0.0);
        let shown = rest / (used as f64 - 6.0).max(1.0);
        let covariance = cholesky.inverse() * shown.max(1.0);
        let slope = Vector2::new(solution[1], solution[2]) / radius_m;
        let bend = [3, 4, 5].map(|i| solution[i] / (radius_m * radius_m));
        // From the height to the shape operator, and from slopes that are nearly zero to the
        // rotation of the frame.
        let length = (1.0 + slope.norm_squared()).sqrt();
        let shape = Matrix2::new(-2.0 * bend[0], -bend[1], -bend[1], -2.0 * bend[2]) / length;
        let steep = slope.norm();
        let turned = frame.turned(&(slope * -(steep.atan() / steep.max(1e-12))));
        let by = Vector3::new(2.0, 1.0, 2.0) / (radius_m * radius_m);
        let of_bend: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into();
        let of_slope: Matrix2<f64> = covariance.fixed_view::<2, 2>(1, 1).into();
        // Tilt due to an error that is correlated over half of the patch.
        let ripple = 2.0 * self.config.ripple_sd_m / radius_m;
        // A change of the curvature's rate of change looks like curvature: a fourteenth of it times
        // the square of the radius.
        let fourth =
            self.config.bend_change_sd_per_m2 / CHANGE_LENGTH_M * radius_m * radius_m / 14.0;
        let hidden = Matrix3::from_diagonal(&Vector3::new(1.0, 0.25, 1.0)) * (fourth * fourth);
        Ok(Patch {
            place: Place {
                point: place.point + frame.normal * solution[0],
                normal: turned.normal,
                shape: turned.lift_matrix(&shape),
            },
            frame: turned,
            covariance: of_slope / (radius_m * radius_m) + Matrix2::identity() * ripple.powi(2),
            shape,
            shape_covariance: of_bend.component_mul(&(by * by.transpose())) + hidden,
            radius_m,
            cells: used,
        })
    }
}

fn octant(x: f64, y: f64) -> u8 {
    u8::from(x >= 0.0) | u8::from(y >= 0.0) << 1 | u8::from(x.abs() > y.abs()) << 2
}

/// Longest run of empty octants around the middle, out of eight.
fn longest_gap(octants: u8) -> u32 {
    // Counter-clockwise.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octants_are_in_the_order_of_the_gap() {
        // One point in each octant of the circle in turn: a gap of n neighbouring octants has
        // length n wherever it begins.
        let turn: Vec<u8> = (0..8)
            .map(|i| {
                let angle = (f64::from(i) + 0.5) * std::f64::consts::FRAC_PI_4;
                octant(angle.cos(), angle.sin())
            })
            .collect();
        for first in 0..8 {
            for wide in 0..8u32 {
                let gap = |i: usize| (i + 8 - first) % 8 < wide as usize;
                let seen = (0..8)
                    .filter(|i| !gap(*i))
                    .fold(0, |bits, i| bits | 1 << turn[i]);
                assert_eq!(longest_gap(seen), wide, "{first} {wide}");
            }
        }
        assert_eq!(longest_gap(0), 8);
    }
}
