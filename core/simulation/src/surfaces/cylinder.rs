//! An infinite cylinder around the local z axis: a pipe.

use nalgebra::{Matrix3, Vector3};

use super::ray::{Ray, roots};
use super::shape::Shape;

/// Material where the distance from the z axis is below the radius.
#[derive(Clone, Copy, Debug)]
pub struct Cylinder {
    radius: f64,
}

impl Cylinder {
    /// Cylinder with `radius` in m.
    pub fn new(radius: f64) -> Self {
        Self { radius }
    }
}

/// Unit vector from the z axis to `point`, and the distance from the axis; the x axis for a point
/// on the z axis.
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

    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        let (o, d) = (ray.origin.xy(), ray.direction.xy());
        let (a, c) = (
            d.norm_squared(),
            o.norm_squared() - self.radius * self.radius,
        );
        if a == 0.0 {
            return (c <= 0.0).then_some(range[0]);
        }
        Ray::first(range, roots(a, o.dot(&d), c)?)
    }
}
