//! A cone around the local z axis: a traffic cone's side, continued without base and tip radius.

use nalgebra::{Matrix3, Vector3};

use super::Shape;
use super::cylinder::radial;

/// Material inside the side of the cone whose tip is at `z = height` and whose radius at `z = 0` is `base_radius`.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    height: f64,
    slope: f64,
    cos: f64,
    sin: f64,
}

impl Cone {
    /// Height of the tip and radius at `z = 0`, m.
    pub fn new(height: f64, base_radius: f64) -> Self {
        let slant = height.hypot(base_radius);
        Self {
            height,
            slope: base_radius / height,
            cos: height / slant,
            sin: base_radius / slant,
        }
    }
}

impl Shape for Cone {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (out, rho) = radial(point);
        let distance = (rho - (self.height - point.z) * self.slope) * self.cos;
        (distance, out * self.cos + Vector3::z() * self.sin)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let (out, rho) = radial(point);
        let (distance, _) = self.distance_and_normal(point);
        // Meusnier: the circle around the axis has curvature 1/rho, of which cos(half angle) is along the normal.
        let rho_on_surface = (rho - distance * self.cos).max(1e-6);
        let around = Vector3::z().cross(&out);
        around * around.transpose() * (self.cos / rho_on_surface)
    }
}
