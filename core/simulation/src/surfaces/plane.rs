//! The half space below `z = 0`.

use nalgebra::{Matrix3, Vector3};

use super::Shape;

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
}
