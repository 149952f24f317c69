//! A sheet waved in both directions.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::Shape;
use super::graph::{self, Graph};

/// `z = a_x sin(k_x x) + a_y sin(k_y y)`, material below.
#[derive(Clone, Copy, Debug)]
pub struct Sheet {
    amplitude: [f64; 2],
    wavenumber: [f64; 2],
}

impl Sheet {
    /// Amplitudes and wavelengths along x and y, m.
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
}

impl Shape for Sheet {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        graph::distance_and_normal(self, point)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        graph::curvature(self, point)
    }
}
