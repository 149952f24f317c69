//! The half space below `z = 0`.

use nalgebra::{Matrix3, Vector3};

use super::ray::Ray;
use super::shape::Shape;

/// Material where `z < 0`.
#[derive(Clone, Copy, Debug)]
pub struct Plane;

impl Shape for Plane {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        (point.z, Vector3::z())
    }

    fn curvature(&self, _point: &Vector3<f64>) -> Matrix3<f64> {
        Matrix3::zeros()
    }

    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        let (height, fall) = (ray.at(range[0]).z, -ray.direction.z);
        let inside = match (height <= 0.0, fall > 0.0) {
            (true, _) => range[0],
            (false, true) => range[0] + height / fall,
            (false, false) => return None,
        };
        Ray::first(range, [inside, f64::INFINITY])
    }
}
