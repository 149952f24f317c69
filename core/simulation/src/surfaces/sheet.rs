//! A sheet with sine waves in both directions.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::graph::{self, Graph};
use super::ray::{self, Ray};
use super::shape::Shape;

/// `z = a_x sin(k_x x) + a_y sin(k_y y)`, with the material below.
#[derive(Clone, Copy, Debug)]
pub struct Sheet {
    amplitude: [f64; 2],
    wavenumber: [f64; 2],
}

impl Sheet {
    /// Sheet with amplitudes and wavelengths along x and y, m.
    pub fn new(amplitude: [f64; 2], wavelength: [f64; 2]) -> Self {
        Self {
            amplitude,
            wavenumber: wavelength.map(|l| std::f64::consts::TAU / l),
        }
    }
}

impl Graph for Sheet {
    fn height(&self, x: f64, y: f64) -> (f64, Vector2<f64>, Matrix2<f64>) {
        let ([ax, ay], [kx, ky]) = (self.amplitude, self.wavenumber);
        let ((sx, cx), (sy, cy)) = ((kx * x).sin_cos(), (ky * y).sin_cos());
        (
            ax * sx + ay * sy,
            Vector2::new(ax * kx * cx, ay * ky * cy),
            Matrix2::new(-ax * kx * kx * sx, 0.0, 0.0, -ay * ky * ky * sy),
        )
    }

    fn slope_max(&self) -> f64 {
        let [x, y] = [0, 1].map(|i| self.amplitude[i] * self.wavenumber[i]);
        (x * x + y * y).sqrt()
    }

    fn curvature_max(&self) -> f64 {
        let [x, y] = [0, 1].map(|i| self.amplitude[i].abs() * self.wavenumber[i].powi(2));
        x.max(y)
    }

    fn detail_m(&self) -> f64 {
        // An eighth of the shorter wave among those that there are.
        let waves = (0..2).filter(|&i| self.amplitude[i] != 0.0);
        let finest = waves.map(|i| self.wavenumber[i]).fold(1e-3, f64::max);
        std::f64::consts::TAU / finest / 8.0
    }

    fn height_range(&self) -> [f64; 2] {
        let most = self.amplitude[0].abs() + self.amplitude[1].abs();
        [-most, most]
    }
}

impl Shape for Sheet {
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
