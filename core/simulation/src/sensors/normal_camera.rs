//! A camera reduced to the input of a law: the surface's normal at the tool, with a camera's rate,
//! delay and errors. No image is rendered, so runs are fast. The source that renders and reads
//! depth images gives samples of the same form.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use tangent_control::{BendChange, VisionInput};
use tangent_sensing::Validity;

use crate::plant_error::PlantError;
use crate::surfaces::Surface;

/// Largest number of samples in transit at once.
const UNDER_WAY_MAX: usize = 32;
/// Speed below which the tool counts as standing still and has no direction of travel, m/s.
const TRAVEL_MIN_M_PER_S: f64 = 0.005;
/// Number of stations of the map ahead, and the distance between them, m.
const STATIONS: usize = 5;
const STATION_M: f64 = 0.01;

/// The `[plant.camera]` table of a visuo-tactile scenario.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NormalCameraConfig {
    /// Frames per second; 0 for no camera.
    pub rate_hz: f64,
    /// From exposure to the normal's arrival, s.
    pub delay_s: f64,
    /// Error of each frame's normal about each axis perpendicular to it, standard deviation, rad.
    pub normal_sd_rad: f64,
    /// Constant error due to the camera's mounting, about each axis, standard deviation over seeds,
    /// rad.
    pub mounting_sd_rad: f64,
    /// Error of the shape operator's entries, standard deviation, 1/m.
    pub curvature_sd_per_m: f64,
    /// Radius of the patch over which the surface variation is computed, m.
    pub patch_radius_m: f64,
    /// Range noise on that patch, m.
    pub range_noise_m: f64,
}

impl Default for NormalCameraConfig {
    fn default() -> Self {
        Self {
            rate_hz: 30.0,
            delay_s: 0.045,
            normal_sd_rad: 0.010,
            mounting_sd_rad: 0.005,
            curvature_sd_per_m: 0.7,
            patch_radius_m: 0.04,
            range_noise_m: 0.001,
        }
    }
}

impl NormalCameraConfig {
    /// Checks that every number is in its range.
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        for (key, x, max, allowed) in [
            ("camera.rate_hz", self.rate_hz, 500.0, "0 to 500 Hz"),
            ("camera.delay_s", self.delay_s, 0.2, "0 to 0.2 s"),
            (
                "camera.normal_sd_rad",
                self.normal_sd_rad,
                1.0,
                "0 to 1 rad",
            ),
            (
                "camera.mounting_sd_rad",
                self.mounting_sd_rad,
                1.0,
                "0 to 1 rad",
            ),
            (
                "camera.curvature_sd_per_m",
                self.curvature_sd_per_m,
                100.0,
                "0 to 100 1/m",
            ),
            (
                "camera.patch_radius_m",
                self.patch_radius_m,
                0.5,
                "0 to 0.5 m",
            ),
            (
                "camera.range_noise_m",
                self.range_noise_m,
                0.1,
                "0 to 0.1 m",
            ),
        ] {
            PlantError::unless(key, x, allowed, (0.0..=max).contains(&x))?;
        }
        Ok(())
    }
}

/// The camera with the samples in transit.
#[derive(Clone, Debug)]
pub struct NormalCamera {
    config: NormalCameraConfig,
    mounting: Vector3<f64>,
    rng: Pcg64Mcg,
    taken: u64,
    under_way: ArrayVec<(f64, VisionInput), UNDER_WAY_MAX>,
    /// Position of the tool at the previous frame, m.
    last_at: Option<Vector3<f64>>,
}

impl NormalCamera {
    /// Creates a camera; `seed` determines the error of its mounting.
    pub fn new(config: &NormalCameraConfig, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x0de9_7400_a11c_a3e5);
        let mounting = vector(&mut rng) * config.mounting_sd_rad;
        Self {
            config: *config,
            mounting,
            rng,
            taken: 0,
            under_way: ArrayVec::new(),
            last_at: None,
        }
    }

    /// Takes a frame if one is due at `time_s`, with the tool's origin at `at` (base axes, m).
    pub fn expose(&mut self, time_s: f64, surface: &Surface, at: &Vector3<f64>) {
        let c = self.config;
        if c.rate_hz <= 0.0 || time_s * c.rate_hz + 1e-9 < self.taken as f64 {
            return;
        }
        self.taken = (time_s * c.rate_hz + 1e-9).floor() as u64 + 1;
        let under = surface.query(at);
        let turn = self.mounting + vector(&mut self.rng) * c.normal_sd_rad;
        let n = under.normal;
        let project = Matrix3::identity() - n * n.transpose();
        let normal = (n + turn.cross(&n)).normalize();
        let noise = Matrix3::from_fn(|_, _| StandardNormal.sample(&mut self.rng));
        let noise = project * (noise + noise.transpose()) * project * (0.5 * c.curvature_sd_per_m);
        let way = at - self.last_at.replace(*at).unwrap_or(*at);
        let travels = way.norm() * c.rate_hz > TRAVEL_MIN_M_PER_S;
        let change = (travels && c.curvature_sd_per_m > 0.0)
            .then(|| self.ahead(surface, &(project * way).normalize(), &under.point))
            .flatten();
        let sd = (c.normal_sd_rad.powi(2) + c.mounting_sd_rad.powi(2)).max(1e-8);
        let sample = VisionInput {
            time_s,
            point: under.point,
            normal,
            covariance: (Matrix3::identity() - normal * normal.transpose()) * sd,
            surface_variation: Some(surface_variation(
                &under.curvature,
                c.patch_radius_m,
                c.range_noise_m,
            )),
            curvature: Some(under.curvature + noise),
            change,
            validity: Validity::Valid,
        };
        if self.under_way.is_full() {
            self.under_way.remove(0);
        }
        self.under_way.push((time_s + c.delay_s, sample));
    }

    /// Change of the curvature along `way`, from stations like those of a map ahead.
    fn ahead(
        &mut self,
        surface: &Surface,
        way: &Vector3<f64>,
        from: &Vector3<f64>,
    ) -> Option<BendChange> {
        let sd = self.config.curvature_sd_per_m;
        let stations: [(f64, f64, f64); STATIONS] = std::array::from_fn(|i| {
            let distance = STATION_M * i as f64;
            let there = surface.query(&(from + way * distance));
            let noise: f64 = StandardNormal.sample(&mut self.rng);
            let bend = way.dot(&(there.curvature * way)) + noise * sd;
            (distance, bend, sd)
        });
        BendChange::of(way, stations.into_iter())
    }

    /// The newest sample that has arrived since the last call.
    pub fn take(&mut self, time_s: f64) -> Option<VisionInput> {
        let mut newest = None;
        while self
            .under_way
            .first()
            .is_some_and(|(at, _)| *at <= time_s + 1e-9)
        {
            newest = Some(self.under_way.remove(0).1);
        }
        newest
    }

    /// Number of frames taken so far.
    pub fn frames(&self) -> u64 {
        self.taken
    }
}

/// Surface variation λ₃ / tr Σ of the points on a round patch, eq. (16), in closed form. On `z =
/// (k₁ x² + k₂ y²) / 2` over a disk of radius r, the heights have the variance r⁴/64 (k₁² + k₂² -
/// 2/3 k₁ k₂), and each tangential axis has r²/4.
pub(crate) fn surface_variation(curvature: &Matrix3<f64>, radius_m: f64, noise_m: f64) -> f64 {
    let eigen = SymmetricEigen::new(*curvature).eigenvalues;
    // The eigenvalue along the normal is zero, so the sums need not exclude it.
    let squares = eigen.norm_squared();
    let product = eigen.x * eigen.y + eigen.y * eigen.z + eigen.z * eigen.x;
    let across = 0.25 * radius_m * radius_m;
    let along = radius_m.powi(4) / 64.0 * (squares - 2.0 / 3.0 * product) + noise_m * noise_m;
    let trace = 2.0 * across + along;
    if trace > 0.0 { along / trace } else { 0.0 }
}

fn vector(rng: &mut Pcg64Mcg) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_config::PoseConfig;
    use crate::surfaces::ShapeConfig;

    #[test]
    fn the_surface_variation_is_that_of_the_points() {
        let (k1, k2, r) = (5.0, -2.0, 0.05);
        let (mut n, mut sum, mut square, mut across) = (0.0, 0.0, 0.0, 0.0);
        let steps = 400;
        for i in -steps..=steps {
            for j in -steps..=steps {
                let (x, y) = (
                    r * f64::from(i) / f64::from(steps),
                    r * f64::from(j) / f64::from(steps),
                );
                if x * x + y * y <= r * r {
                    let z = 0.5 * (k1 * x * x + k2 * y * y);
                    n += 1.0;
                    sum += z;
                    square += z * z;
                    across += x * x + y * y;
                }
            }
        }
        let variance = square / n - (sum / n) * (sum / n);
        let expected = variance / (variance + across / n);
        let shape = Matrix3::from_diagonal(&Vector3::new(k1, k2, 0.0));
        let found = surface_variation(&shape, r, 0.0);
        assert!(
            (found - expected).abs() < 1e-3 * expected,
            "{found} {expected}"
        );
    }

    #[test]
    fn frames_come_at_their_rate_and_late_by_their_delay() {
        let plane = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
        let mut camera = NormalCamera::new(&NormalCameraConfig::default(), 3);
        let mut arrived = Vec::new();
        for i in 0..=1000 {
            let time = f64::from(i) * 1e-3;
            camera.expose(time, &plane, &Vector3::zeros());
            if let Some(sample) = camera.take(time) {
                arrived.push(time - sample.time_s);
                assert!(sample.normal.angle(&Vector3::z()) < 0.08);
            }
        }
        assert!((28..=30).contains(&arrived.len()), "{}", arrived.len());
        assert!(arrived.iter().all(|age| (0.0449..0.0461).contains(age)));
        assert_eq!(camera.frames(), 31);
    }
}
