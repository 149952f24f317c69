//! What a tool meets on its way off a surface: for tests of retractions.
//!
//! Put into a plant while it runs; it stands from there on.

use nalgebra::Vector3;

use crate::contact::PadContact;

/// A flat, frictionless wall across the surface's normal, behind the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Way of the tool along the normal until it meets the wall, m.
    pub gap_m: f64,
    /// N/m
    pub stiffness_n_per_m: f64,
}

/// An obstacle in its place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    obstacle: Obstacle,
    /// Where the tool was when it was put there, m.
    at: Vector3<f64>,
    /// Of the surface under the tool then, out of the material.
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

    /// Adds what the obstacle does to a tool at `origin`, m.
    pub fn push(&self, origin: &Vector3<f64>, contact: &mut PadContact) {
        let beyond_m = self.normal.dot(&(origin - self.at)) - self.obstacle.gap_m;
        contact.force -= self.normal * (self.obstacle.stiffness_n_per_m * beyond_m.max(0.0));
    }
}
