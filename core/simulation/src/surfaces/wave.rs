//! A block with vertical sides and a wave across its top. A tool can slide off it and hit its side
//! on the way back.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::graph::{self, Graph};
use super::ray::{self, Ray};
use super::shape::Shape;

/// `z = a sin(2 pi y / l + phase) + offset` over a rectangle around the origin, with the material
/// below it unbounded. Karacan et al., III: a block of 0.26 x 0.51 m with a = 0.02 m, l = 0.38 m,
/// phase 0.44 rad and an offset of 0.02 m.
#[derive(Clone, Copy, Debug)]
pub struct Wave {
    amplitude: f64,
    wavenumber: f64,
    phase: f64,
    offset: f64,
    half_size: [f64; 2],
}

impl Wave {
    /// Lengths in m, phase in rad; `size` along x and y.
    pub fn new(amplitude: f64, wavelength: f64, phase: f64, offset: f64, size: [f64; 2]) -> Self {
        Self {
            amplitude,
            wavenumber: std::f64::consts::TAU / wavelength,
            phase,
            offset,
            half_size: size.map(|s| 0.5 * s),
        }
    }

    /// Distance and normal for a point beside the block or above its edges: to a side, or to the
    /// edge of the top.
    fn beside(&self, point: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        let [a, b] = self.half_size;
        let (x, y) = (point.x.clamp(-a, a), point.y.clamp(-b, b));
        let nearest = Vector3::new(x, y, point.z.min(self.height(x, y).0));
        let away = point - nearest;
        let distance = away.norm();
        let past = point.x != x || point.y != y;
        (past && distance > 1e-9).then(|| (distance, away / distance))
    }

    /// The nearest side of the block: its signed distance and normal.
    fn side(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (x, y) = (
            point.x.abs() - self.half_size[0],
            point.y.abs() - self.half_size[1],
        );
        if x > y {
            (x, Vector3::x() * point.x.signum())
        } else {
            (y, Vector3::y() * point.y.signum())
        }
    }
}

impl Graph for Wave {
    fn height(&self, _x: f64, y: f64) -> (f64, Vector2<f64>, Matrix2<f64>) {
        let (a, k) = (self.amplitude, self.wavenumber);
        let (s, c) = (k * y + self.phase).sin_cos();
        (
            a * s + self.offset,
            Vector2::new(0.0, a * k * c),
            Matrix2::new(0.0, 0.0, 0.0, -a * k * k * s),
        )
    }

    fn slope_max(&self) -> f64 {
        self.amplitude * self.wavenumber
    }

    fn curvature_max(&self) -> f64 {
        self.amplitude * self.wavenumber * self.wavenumber
    }

    fn detail_m(&self) -> f64 {
        std::f64::consts::TAU / self.wavenumber / 8.0
    }

    fn height_range(&self) -> [f64; 2] {
        [self.offset - self.amplitude, self.offset + self.amplitude]
    }
}

impl Shape for Wave {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        if let Some(outside) = self.beside(point) {
            return outside;
        }
        let (top, side) = (graph::distance_and_normal(self, point), self.side(point));
        // The distance inside is that of the nearest way out. A tool that slid off, sank and comes
        // back touches the side. With the top alone it would suddenly be centimetres deep, and the
        // simulation would create energy.
        if top.0 >= side.0 { top } else { side }
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        graph::curvature(self, point)
    }

    /// Intersects the wave without its edges: a camera's `extent_m` cuts those.
    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        ray::march_graph(self, ray, range)
    }
}
