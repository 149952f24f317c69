//! Renders the grey image that a camera takes of the target, with blur and noise, as input of
//! `tangent_sensing::TargetDetector`.

use nalgebra::{Matrix3, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use tangent_estimation::{CORNERS, CameraModel};
use tangent_mechanics::{Camera, Object, Pose};
use tangent_sensing::GreyImage;

/// Grey values of the plate, of its dark cells and of the background.
const LIGHT: f64 = 210.0;
const DARK: f64 = 35.0;
const AROUND: f64 = 120.0;
/// Samples per pixel along each axis.
const SAMPLES: u32 = 3;

/// The `[plant.camera.image]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImageConfig {
    /// Side length of a mark's cell, m.
    pub cell_m: f64,
    /// Radius of the dot, m.
    pub dot_radius_m: f64,
    /// Blur of the lens, standard deviation, pixels.
    pub blur_px: f64,
    /// Noise of a pixel, standard deviation, grey values.
    pub noise_grey: f64,
}

impl Default for ImageConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.015,
            dot_radius_m: 0.008,
            blur_px: 0.7,
            noise_grey: 2.0,
        }
    }
}

/// The plate in its own axes: x along its first edge, y perpendicular to it, origin at corner 0, m.
struct Plate<'a> {
    config: &'a ImageConfig,
    corners: [Vector2<f64>; CORNERS],
    middle: Vector2<f64>,
    dot: Vector2<f64>,
    reach: f64,
}

impl Plate<'_> {
    fn grey(&self, p: &Vector2<f64>) -> f64 {
        let from_middle = p - self.middle;
        if from_middle.amax() > self.reach {
            return AROUND;
        }
        let cell = self.config.cell_m;
        let marked = self.corners.iter().any(|corner| {
            let d = p - corner;
            d.amax() < cell && d.x * d.y > 0.0
        });
        if marked || (p - self.dot).norm() < self.config.dot_radius_m {
            DARK
        } else {
            LIGHT
        }
    }
}

/// Renders the image of a square target (corners in object axes, m) from the camera's pose.
pub fn draw(
    config: &ImageConfig,
    camera: &CameraModel,
    size_px: [u32; 2],
    camera_from_object: &Pose<Camera, Object>,
    corners_m: &[Vector3<f64>; CORNERS],
    rng: &mut Pcg64Mcg,
) -> GreyImage {
    let x = (corners_m[1] - corners_m[0]).normalize();
    let z = x.cross(&(corners_m[2] - corners_m[0])).normalize();
    let y = z.cross(&x);
    let flat = |p: &Vector3<f64>| {
        let d = p - corners_m[0];
        Vector2::new(d.dot(&x), d.dot(&y))
    };
    let corners = corners_m.map(|c| flat(&c));
    let middle = corners.iter().sum::<Vector2<f64>>() / CORNERS as f64;
    let half = corners
        .iter()
        .map(|c| (c - middle).amax())
        .fold(0.0, f64::max);
    let plate = Plate {
        config,
        dot: (middle + corners[0]) * 0.5,
        corners,
        middle,
        reach: half + 1.6 * config.cell_m,
    };
    // Homography from the plate to the image; its inverse maps a pixel back to the plate.
    let [width, height] = size_px;
    let columns = [
        camera_from_object.rotate(&x),
        camera_from_object.rotate(&y),
        camera_from_object.transform_point(&corners_m[0]),
    ];
    let plate_from_ray = Matrix3::from_columns(&columns).try_inverse();
    let mut window = Window::empty(config.blur_px);
    if let Some(plate_from_ray) = plate_from_ray {
        let seen = seen_part(
            &plate,
            camera,
            size_px,
            camera_from_object,
            corners_m,
            [x, y],
        );
        window = Window::around(seen, size_px, config.blur_px);
        window.fill(|column, row| {
            let mut sum = 0.0;
            for i in 0..SAMPLES * SAMPLES {
                let share = |k: u32| (f64::from(k) + 0.5) / f64::from(SAMPLES) - 0.5;
                let pixel = Vector2::new(
                    f64::from(column) + share(i % SAMPLES),
                    f64::from(row) + share(i / SAMPLES),
                );
                let ray = camera.normalised(&pixel).push(1.0);
                let p = plate_from_ray * ray;
                // A plate behind the camera is not visible.
                sum += if p.z > 0.0 {
                    plate.grey(&(p.xy() / p.z))
                } else {
                    AROUND
                };
            }
            sum / f64::from(SAMPLES * SAMPLES)
        });
        window.blur();
    }
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    for row in 0..height {
        for column in 0..width {
            let value = window.at(column, row);
            let noise: f64 = StandardNormal.sample(rng);
            // `as` saturates, as an image sensor does.
            pixels.push((value + noise * config.noise_grey).round() as u8);
        }
    }
    GreyImage {
        width,
        height,
        pixels,
    }
}

/// Columns and rows that the plate may cover; the whole image if the plate extends behind the
/// camera.
fn seen_part(
    plate: &Plate<'_>,
    camera: &CameraModel,
    size_px: [u32; 2],
    camera_from_object: &Pose<Camera, Object>,
    corners_m: &[Vector3<f64>; CORNERS],
    axes: [Vector3<f64>; 2],
) -> [(u32, u32); 2] {
    let signs = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let edges = signs.map(|[i, j]| {
        let flat = plate.middle + Vector2::new(i, j) * plate.reach;
        let point = corners_m[0] + axes[0] * flat.x + axes[1] * flat.y;
        camera.project(&camera_from_object.transform_point(&point))
    });
    let mut spans = [(0, size_px[0]), (0, size_px[1])];
    if edges.iter().all(Option::is_some) {
        for (i, span) in spans.iter_mut().enumerate() {
            let along = || edges.iter().flatten().map(|edge| edge[i]);
            let low = along().fold(f64::INFINITY, f64::min) - 1.0;
            let high = along().fold(f64::NEG_INFINITY, f64::max) + 2.0;
            // `as` saturates at zero.
            *span = ((low as u32).min(size_px[i]), (high as u32).min(size_px[i]));
        }
    }
    spans
}

/// The part of an image that is not uniform, with a margin for the blur.
struct Window {
    columns: (u32, u32),
    rows: (u32, u32),
    blur_px: f64,
    grey: Vec<f64>,
}

impl Window {
    fn empty(blur_px: f64) -> Self {
        Self {
            columns: (0, 0),
            rows: (0, 0),
            blur_px,
            grey: Vec::new(),
        }
    }

    fn around(seen: [(u32, u32); 2], size_px: [u32; 2], blur_px: f64) -> Self {
        let margin = 2 * reach(blur_px) as u32;
        let widened = |i: usize| {
            let (low, high): (u32, u32) = seen[i];
            if low >= high {
                return (0, 0);
            }
            (low.saturating_sub(margin), (high + margin).min(size_px[i]))
        };
        let (columns, rows) = (widened(0), widened(1));
        let pixels = (columns.1 - columns.0) as usize * (rows.1 - rows.0) as usize;
        Self {
            columns,
            rows,
            blur_px,
            grey: vec![AROUND; pixels],
        }
    }

    fn width(&self) -> usize {
        (self.columns.1 - self.columns.0) as usize
    }

    fn fill(&mut self, grey: impl Fn(u32, u32) -> f64) {
        let (columns, rows) = (self.columns, self.rows);
        let places = (rows.0..rows.1).flat_map(|row| (columns.0..columns.1).map(move |c| (c, row)));
        for (value, (column, row)) in self.grey.iter_mut().zip(places) {
            *value = grey(column, row);
        }
    }

    /// Gaussian blur along rows, then along columns; border pixels keep their value.
    fn blur(&mut self) {
        if self.blur_px <= 0.0 || self.grey.is_empty() {
            return;
        }
        let reach = reach(self.blur_px);
        let weight = |k: usize| (-0.5 * (k as f64 / self.blur_px).powi(2)).exp();
        let total: f64 = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f64>();
        let weights: Vec<f64> = (0..=reach).map(|k| weight(k) / total).collect();
        let pass = |from: &[f64], step: usize| {
            let mut to = from.to_vec();
            let margin = reach * step;
            for at in margin..from.len().saturating_sub(margin) {
                let sides =
                    (1..=reach).map(|k| weights[k] * (from[at - k * step] + from[at + k * step]));
                to[at] = weights[0] * from[at] + sides.sum::<f64>();
            }
            to
        };
        self.grey = pass(&pass(&self.grey, 1), self.width());
    }

    fn at(&self, column: u32, row: u32) -> f64 {
        let inside = (self.columns.0..self.columns.1).contains(&column)
            && (self.rows.0..self.rows.1).contains(&row);
        if !inside {
            return AROUND;
        }
        let (column, row) = (column - self.columns.0, row - self.rows.0);
        self.grey[row as usize * self.width() + column as usize]
    }
}

/// Radius of the blur kernel, pixels.
fn reach(blur_px: f64) -> usize {
    (3.0 * blur_px).ceil() as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;
    use rand::SeedableRng;
    use tangent_sensing::TargetDetector;

    fn square() -> [Vector3<f64>; CORNERS] {
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|[x, y]| Vector3::new(0.05 * x, 0.05 * y, 0.0))
    }

    #[test]
    fn the_corners_are_found_where_the_projection_has_them() {
        let camera = CameraModel {
            flange_from_camera: Pose::identity(),
            focal_px: 400.0,
            principal_px: Vector2::new(322.3, 236.8),
            pixel_m: 2e-5,
        };
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut squares = (0.0, 0);
        for k in 0..12 {
            let k = f64::from(k);
            let turn = Vector3::new(0.25 * (k * 1.7).sin(), 0.25 * (k * 2.3).cos(), 0.5 * k);
            let pose = Pose::new(
                Vector3::new(
                    0.05 * (k * 0.9).sin(),
                    0.04 * (k * 1.3).cos(),
                    0.3 + 0.02 * k,
                ),
                UnitQuaternion::from_scaled_axis(turn) * down,
            );
            let image = draw(
                &ImageConfig::default(),
                &camera,
                [640, 480],
                &pose,
                &square(),
                &mut rng,
            );
            let found = TargetDetector::new().unwrap().detect(&image).unwrap();
            for (corner, found) in square().iter().zip(&found) {
                let truth = camera.project(&pose.transform_point(corner)).unwrap();
                let found = found.unwrap_or_else(|| panic!("{k}: nothing near {truth}"));
                assert!((found - truth).norm() < 0.5, "{k}: {found} {truth}");
                squares.0 += (found - truth).norm_squared();
                squares.1 += 2;
            }
        }
        let rms = (squares.0 / f64::from(squares.1)).sqrt();
        assert!(rms < 0.12, "{rms} px");
    }
}
