//! Where the tool presses on the surface, and how hard: for what is drawn, and for the dose of
//! pressure.

use nalgebra::Vector3;
use tangent_control::Phase;
use tangent_mechanics::{Base, Pose, Tip, Tool, World};
use tangent_schemas::tangent::ControlState;

/// Radius that a tool covers whose tip is unknown, m.
pub const COVER_RADIUS_M: f64 = 0.008;

/// The tool on the surface at one moment, world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pressed {
    /// Middle of the area of contact, m.
    pub point: Vector3<f64>,
    /// Unit normal in use, out of the material.
    pub normal: Vector3<f64>,
    /// Pressing force along the normal, N; above zero.
    pub force_n: f64,
    /// Wanted force, N; above zero.
    pub reference_n: f64,
}

impl Pressed {
    /// Reads it from the state of the controller. `None` unless the tool is meant to press and
    /// does, and everything is finite.
    pub fn of(
        control: &ControlState,
        base_from_tool: &Pose<Base, Tool>,
        world_from_base: &Pose<World, Base>,
        tip: &Tip,
    ) -> Option<Self> {
        let (force_n, reference_n) = (control.force_n, control.force_reference_n);
        let is_on_surface = Phase::from_code(control.phase).is_some_and(Phase::is_pressing);
        let presses = reference_n > 0.0 && force_n > 0.0 && force_n.is_finite();
        if !(is_on_surface && presses) {
            return None;
        }
        let normal = Vector3::from(&control.normal).try_normalize(1e-6)?;
        let point = tip.contact_in_tool(&base_from_tool.unrotate(&normal));
        let point = world_from_base.transform_point(&base_from_tool.transform_point(&point));
        let normal = world_from_base.rotate(&normal);
        let finite = point.iter().chain(normal.iter()).all(|x| x.is_finite());
        finite.then_some(Self {
            point,
            normal,
            force_n,
            reference_n,
        })
    }
}

/// Radius of the area that a tip covers, m; for an unknown tip [`COVER_RADIUS_M`].
pub fn cover_radius_m(tip: &Tip) -> f64 {
    tip.radius_m().unwrap_or(COVER_RADIUS_M)
}

/// Two unit vectors at right angles to `normal` and to each other.
pub fn cross_axes(normal: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let least = if normal.x.abs() < 0.6 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let x = (least - normal * least.dot(normal)).normalize();
    (x, normal.cross(&x))
}
