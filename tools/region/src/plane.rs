//! The plane of a task: perpendicular to the approach, with its origin where the tool touches down.

use nalgebra::{Vector2, Vector3};
use tangent_control::contact::alignment::plane_axes;

/// Axes of the path's plane in base axes, and its origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskPlane {
    /// Origin, m.
    pub origin: Vector3<f64>,
    /// Unit x axis.
    pub x: Vector3<f64>,
    /// Unit y axis.
    pub y: Vector3<f64>,
    /// Unit normal, against the approach: out of the material.
    pub normal: Vector3<f64>,
}

impl TaskPlane {
    /// The plane with a normal and the projection of an x axis, as the law sets it up.
    pub fn new(origin: Vector3<f64>, normal: &Vector3<f64>, x_axis: &Vector3<f64>) -> Self {
        let normal = normal.normalize();
        let (x, y) = plane_axes(&normal, x_axis);
        Self {
            origin,
            x,
            y,
            normal,
        }
    }

    /// A place in axes of the plane: x, y and the height over it, m.
    pub fn place(&self, in_base: &Vector3<f64>) -> Vector3<f64> {
        let way = in_base - self.origin;
        Vector3::new(way.dot(&self.x), way.dot(&self.y), way.dot(&self.normal))
    }

    /// A place in axes of the base, m.
    pub fn in_base(&self, place: &Vector3<f64>) -> Vector3<f64> {
        self.origin + self.direction_in_base(place)
    }

    /// A direction in axes of the base.
    pub fn direction_in_base(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.x * direction.x + self.y * direction.y + self.normal * direction.z
    }

    /// This plane with its origin moved to a place in it and a height over it, m.
    pub fn moved_to(&self, at: &Vector2<f64>, height_m: f64) -> Self {
        Self {
            origin: self.in_base(&at.push(height_m)),
            ..*self
        }
    }
}
