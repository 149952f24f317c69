//! What every shape provides, in its own frame.

use nalgebra::{Matrix3, Vector3};

use super::ray::{self, Ray};

/// Faces of a shape that a ball can touch at the same time.
pub const FACES_MAX: usize = 3;

/// Signed distance (m) and unit normal of each face around a point; `None` where a face has no
/// point closest to it. A face keeps its place in the list.
pub type FacesAround = [Option<(f64, Vector3<f64>)>; FACES_MAX];

/// Geometry that every shape provides, in its own frame, m.
pub trait Shape {
    /// Signed distance and the unit normal at the closest point.
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>);

    /// Shape operator at the closest point, 1/m.
    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64>;

    /// The first `t` within `range` at which the ray is inside the material; the start of `range`
    /// if the ray is already inside there. The default is sphere tracing; shapes may override it
    /// with a faster method.
    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        ray::march(ray, range, |p| self.distance_and_normal(p).0)
    }
}
