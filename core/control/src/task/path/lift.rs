//! A lift of the tool between two strokes.

use nalgebra::Vector2;

use super::ranges::{default_lift, default_travel};

/// A way above the surface, in plane coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lift {
    /// Time of the path at which the tool leaves the surface, s.
    pub start_s: f64,
    /// Time of the path at which it is back, s.
    pub end_s: f64,
    /// Where it leaves, m.
    pub from: Vector2<f64>,
    /// Where it lands, m.
    pub to: Vector2<f64>,
}

/// How the tool moves above the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rise {
    /// Height above the surface, m.
    pub lift_m: f64,
    /// Speed, m/s.
    pub speed_m_per_s: f64,
}

impl Default for Rise {
    fn default() -> Self {
        Self {
            lift_m: default_lift(),
            speed_m_per_s: default_travel(),
        }
    }
}
