//! A cylinder around the local z axis, without end: a pipe.

use nalgebra::{Matrix3, Vector3};

use super::Shape;

/// Material where the distance from the z axis is below the radius.
#[derive(Clone, Copy, Debug)]
pub struct Cylinder {
    radius: f64,
}

impl Cylinder {
    /// `radius` in m.
    pub fn new(radius: f64) -> Self {
        Self { radius }
    }
}

/// Unit vector from the z axis to `point`, and its distance from the axis; x where the point lies on the axis.
pub(super) fn radial(point: &Vector3<f64>) -> (Vector3<f64>, f64) {
    let rho = (point.x * point.x + point.y * point.y).sqrt();
    if rho > 1e-12 {
        (Vector3::new(point.x / rho, point.y / rho, 0.0), rho)
    } else {
        (Vector3::x(), rho)
    }
}

impl Shape for Cylinder {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (normal, rho) = radial(point);
        (rho - self.radius, normal)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let (out, _) = radial(point);
        let around = Vector3::z().cross(&out);
        around * around.transpose() / self.radius
    }
}
