//! A ball around the local origin.

use nalgebra::{Matrix3, Vector3};

use super::Shape;

/// Material within `radius` of the origin.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    radius: f64,
}

impl Sphere {
    /// `radius` in m.
    pub fn new(radius: f64) -> Self {
        Self { radius }
    }
}

impl Shape for Sphere {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let length = point.norm();
        let normal = if length > 1e-12 {
            point / length
        } else {
            Vector3::z()
        };
        (length - self.radius, normal)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let (_, normal) = self.distance_and_normal(point);
        (Matrix3::identity() - normal * normal.transpose()) / self.radius
    }
}
