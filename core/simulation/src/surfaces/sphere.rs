//! A sphere around the local origin.

use nalgebra::{Matrix3, Vector3};

use super::ray::{Ray, roots};
use super::shape::Shape;

/// Material within `radius` of the origin.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    radius: f64,
}

impl Sphere {
    /// Sphere with `radius` in m.
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

    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        let (o, d) = (&ray.origin, &ray.direction);
        let c = o.norm_squared() - self.radius * self.radius;
        Ray::first(range, roots(d.norm_squared(), o.dot(d), c)?)
    }
}
