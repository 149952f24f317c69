//! A block with a wave across its top, and edges: what the tool leaves when it slides too far.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::Shape;
use super::graph::{self, Graph};
use super::ray::{self, Ray};

/// `z = a sin(2 pi y / l + phase) + offset` over a rectangle around the origin, material below. Karacan et al., III: the block of
/// 0.26 x 0.51 m with a = 0.02 m, l = 0.38 m, phase 0.44 rad and an offset of 0.02 m.
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

    /// The nearest point of the top where `point` is past an edge. A pad's points are what feel an edge, so the sides of the block
    /// need no more than to be no top.
    fn edge(&self, point: &Vector3<f64>) -> Option<Vector3<f64>> {
        let [a, b] = self.half_size;
        if point.x.abs() <= a && point.y.abs() <= b {
            return None;
        }
        let (x, y) = (point.x.clamp(-a, a), point.y.clamp(-b, b));
        Some(Vector3::new(x, y, self.height(x, y).0))
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
}

impl Shape for Wave {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        if let Some(edge) = self.edge(point) {
            let away = point - edge;
            let distance = away.norm();
            if distance > 1e-9 {
                return (distance, away / distance);
            }
        }
        graph::distance_and_normal(self, point)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        graph::curvature(self, point)
    }

    /// Of the wave without its edges: a camera's `extent_m` cuts those.
    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        ray::march_graph(self, ray, range)
    }
}
