//! Where the surface is expected at a place that the tool has not reached: the expected surface of
//! the task, moved and tilted as the felt places ask for.
//!
//! The felt places give residuals `r = felt height - expected height`. A plane `r = a + b x + c y`
//! is fitted to them by least squares, with a prior of zero on the tilt `(b, c)`. Near a felt
//! place, what is left of its residual is added. Called by a lift; does not allocate.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::surface_chart::SurfaceChart;
use super::tracking::Tracking;
use crate::task::{ExpectedSurface, normal_of};

/// Standard deviations of a residual, m, and of the tilt of the expected surface, m per m.
const RESIDUAL_SD_M: f64 = 0.001;
const TILT_SD: f64 = 0.15;
/// Distance over which the residual of a single place loses its weight, m.
const NEAR_M: f64 = 0.02;

/// The expected surface, corrected by touch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected<'a> {
    surface: &'a ExpectedSurface,
    /// Residual at the origin, m, and its slope.
    shift_m: f64,
    tilt: Vector2<f64>,
}

impl<'a> Expected<'a> {
    /// Corrects the expected surface by all felt places, or by the tool's own place `at` (m, base
    /// axes) if there are none.
    pub fn new(
        surface: &'a ExpectedSurface,
        chart: &SurfaceChart,
        tracking: &Tracking,
        at: &Vector3<f64>,
    ) -> Self {
        let here = tracking.over(at);
        let first = tracking.height_m(at) - surface.height_m(&here);
        let (mut left, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
        let mut add = |at: &Vector2<f64>, residual_m: f64| {
            let row = Vector3::new(1.0, at.x, at.y);
            left += row * row.transpose();
            right += row * residual_m;
        };
        for felt in chart.felt() {
            let residual_m = tracking.height_m(&felt.position) - surface.height_m(&felt.in_plane);
            add(&felt.in_plane, residual_m);
            count += 1;
        }
        if count == 0 {
            add(&here, first);
        }
        let prior = (RESIDUAL_SD_M / TILT_SD).powi(2);
        left += Matrix3::from_diagonal(&Vector3::new(0.0, prior, prior));
        let fit = left
            .cholesky()
            .map_or(Vector3::new(first, 0.0, 0.0), |c| c.solve(&right));
        Self {
            surface,
            shift_m: fit.x,
            tilt: Vector2::new(fit.y, fit.z),
        }
    }

    /// Expected height over the plane, m.
    pub fn height_m(&self, at: &Vector2<f64>) -> f64 {
        self.surface.height_m(at) + self.shift_m + self.tilt.dot(at)
    }

    /// Expected height over the plane, m, with the residual of a felt place near it.
    pub fn height_near_m(
        &self,
        at: &Vector2<f64>,
        chart: &SurfaceChart,
        tracking: &Tracking,
    ) -> f64 {
        let left_m = chart.nearest(at, 2.0 * NEAR_M).map_or(0.0, |felt| {
            let left_m = tracking.height_m(&felt.position) - self.height_m(&felt.in_plane);
            left_m * (-((felt.in_plane - at).norm() / NEAR_M).powi(2)).exp()
        });
        self.height_m(at) + left_m
    }

    /// Expected normal, unit, base axes.
    pub fn normal(&self, at: &Vector2<f64>, tracking: &Tracking) -> Vector3<f64> {
        tracking.in_base(&normal_of(&(self.surface.slope(at) + self.tilt)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::surface_chart::Felt;
    use super::*;
    use crate::task::path::{Path, PathSpec};

    /// A wave that is 5 mm too low and tilted by 5 degrees is found after two strokes.
    #[test]
    fn a_shifted_and_tilted_guess_is_corrected_by_what_is_felt() {
        let wave = |x: f64, y: f64| 0.004 * (40.0 * x).sin() + 0.003 * (30.0 * y).cos();
        let surface = ExpectedSurface {
            corner_m: [-0.02, -0.02],
            cell_m: 0.004,
            columns: 36,
            heights_m: (0..36 * 36)
                .map(|k| {
                    let (i, j) = (k % 36, k / 36);
                    wave(-0.02 + 0.004 * f64::from(i), -0.02 + 0.004 * f64::from(j))
                })
                .collect(),
        };
        let truth = |p: &Vector2<f64>| wave(p.x, p.y) + 0.005 + 0.087 * p.y - 0.03 * p.x;
        let spec: PathSpec =
            toml::from_str("kind = \"line\"\nto_m = [0.1, 0.1]\nspeed_m_per_s = 0.05").unwrap();
        let mut chart = SurfaceChart::new(&Path::new(&spec, 0.1, 1.0).unwrap());
        let tracking = Tracking::new(Vector3::z(), Vector3::x(), Vector3::new(0.4, 0.0, 0.1))
            .drawn_over_plane(true);
        let first = tracking.place_over(&Vector2::zeros(), truth(&Vector2::zeros()));
        let alone = Expected::new(&surface, &chart, &tracking, &first);
        let far = Vector2::new(0.09, 0.06);
        assert!((alone.height_m(&far) - truth(&far)).abs() < 0.006);
        for y in [0.0, 0.01] {
            for k in 0..=25 {
                let in_plane = Vector2::new(0.004 * f64::from(k), y);
                chart.record(Felt {
                    in_plane,
                    position: tracking.place_over(&in_plane, truth(&in_plane)),
                    normal: Vector3::z(),
                });
            }
        }
        let expected = Expected::new(&surface, &chart, &tracking, &first);
        let height_m = expected.height_near_m(&far, &chart, &tracking);
        assert!((height_m - truth(&far)).abs() < 0.001, "{height_m}");
        let normal = expected.normal(&far, &tracking);
        let h = 1e-5;
        let slope = Vector2::new(
            (truth(&Vector2::new(far.x + h, far.y)) - truth(&far)) / h,
            (truth(&Vector2::new(far.x, far.y + h)) - truth(&far)) / h,
        );
        assert!(normal.angle(&normal_of(&slope)) < 0.02, "{normal}");
    }
}
