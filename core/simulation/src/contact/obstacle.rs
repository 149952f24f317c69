//! An obstacle in the way of a tool that retracts from a surface, for tests of retractions.
//!
//! It is put into a running plant and stays there.

use nalgebra::Vector3;

use super::pad::PadContact;

/// A flat, frictionless wall perpendicular to the surface's normal, behind the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Distance of the tool from the wall along the normal, m.
    pub gap_m: f64,
    /// Stiffness of the wall, N/m.
    pub stiffness_n_per_m: f64,
}

/// An obstacle with its position.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    obstacle: Obstacle,
    /// Position of the tool when the obstacle was placed, m.
    at: Vector3<f64>,
    /// Normal of the surface under the tool at that time, out of the material.
    normal: Vector3<f64>,
}

impl Placed {
    pub fn new(obstacle: Obstacle, at: Vector3<f64>, normal: Vector3<f64>) -> Self {
        Self {
            obstacle,
            at,
            normal,
        }
    }

    /// Adds the obstacle's force on a tool at `origin` (m).
    pub fn push(&self, origin: &Vector3<f64>, contact: &mut PadContact) {
        let beyond_m = self.normal.dot(&(origin - self.at)) - self.obstacle.gap_m;
        contact.force -= self.normal * (self.obstacle.stiffness_n_per_m * beyond_m.max(0.0));
    }
}
