//! A torus around the local z axis: convex outside, a saddle on the inner side.

use nalgebra::{Matrix3, Vector3};

use super::cylinder::radial;
use super::shape::Shape;

/// Material within `minor` of the circle of radius `major` around the z axis.
#[derive(Clone, Copy, Debug)]
pub struct Torus {
    major: f64,
    minor: f64,
}

impl Torus {
    /// Torus with both radii in m, `minor < major`.
    pub fn new(major: f64, minor: f64) -> Self {
        Self { major, minor }
    }
}

impl Shape for Torus {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (out, rho) = radial(point);
        let (a, b) = (rho - self.major, point.z);
        let length = (a * a + b * b).sqrt();
        if length > 1e-12 {
            (
                length - self.minor,
                out * (a / length) + Vector3::z() * (b / length),
            )
        } else {
            (-self.minor, Vector3::z())
        }
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let (out, _) = radial(point);
        let (_, normal) = self.distance_and_normal(point);
        let around = Vector3::z().cross(&out);
        let along = around.cross(&normal);
        let cos = normal.dot(&out);
        along * along.transpose() / self.minor
            + around * around.transpose() * (cos / (self.major + self.minor * cos))
    }
}
