//! True state of the contact. The system under test never reads it.

use nalgebra::{Isometry3, Matrix3, Vector3};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, World, Wrench};

use crate::contact::{PadContact, PadMotion};
use crate::surfaces::Surface;

/// True state at the end of an arm period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Time since the plant was created, s.
    pub time_s: f64,
    /// Closest point of the surface to the tool's origin, or to the centre of a round tip, base
    /// axes, m.
    pub point: Vector3<f64>,
    /// Unit normal at `point`, out of the material, base axes. Where an edge, a step or a groove
    /// interrupts a plate, it is that of the plate.
    pub normal: Vector3<f64>,
    /// Shape operator at `point`, base axes, 1/m, positive for a convex body.
    pub curvature: Matrix3<f64>,
    /// Signed distance of the tool's origin from the surface, m; of a round tip, that of the ball.
    pub distance_m: f64,
    /// Whether any point of the pad carries load.
    pub in_contact: bool,
    /// Sum of the normal forces of all points that touch, N, in whatever direction each acts.
    pub load_n: f64,
    /// Depth of the deepest pad point, m; 0 without contact.
    pub penetration_m: f64,
    /// Wrench of the surface on the tool, at the tool's origin, base axes.
    pub wrench: Wrench<Aligned<Tool, Base>>,
    /// The pad's true pose, including the deflection of the tool.
    pub base_from_tool: Pose<Base, Tool>,
    /// The pad's true velocity relative to the surface: that of the tool's origin, base axes.
    pub twist: Twist<Aligned<Tool, Base>>,
    /// Speed of the tool's origin in the tangent plane, m/s.
    pub sliding_speed_m_per_s: f64,
    /// Current ratio of tangential to normal force; 0 without contact.
    pub friction_ratio: f64,
    /// Sliding friction coefficient of the material.
    pub friction_coefficient: f64,
    /// Pose of the arm's base: floor axes equal base axes at time zero.
    pub world_from_base: Pose<World, Base>,
}

impl Truth {
    /// Transforms from floor axes to the axes of the base at `floor_from_base`.
    pub(crate) fn seen_from(self, floor_from_base: &Isometry3<f64>) -> Self {
        let back = floor_from_base.inverse();
        let axes = back.rotation.to_rotation_matrix().into_inner();
        let tool = back * self.base_from_tool.isometry();
        Self {
            point: back.transform_point(&self.point.into()).coords,
            normal: axes * self.normal,
            curvature: axes * self.curvature * axes.transpose(),
            wrench: Wrench::new(axes * self.wrench.force, axes * self.wrench.torque),
            base_from_tool: Pose::from_isometry(tool),
            twist: Twist::new(axes * self.twist.linear, axes * self.twist.angular),
            world_from_base: Pose::from_isometry(*floor_from_base),
            ..self
        }
    }
}

impl Truth {
    /// Builds the state from the surface under the pad, the pad's motion and its contact.
    /// `reference` (tool axes, m) and `radius` (m) are those of the tip, [`Pad::reference`].
    ///
    /// [`Pad::reference`]: crate::contact::Pad::reference
    pub(crate) fn of(
        time_s: f64,
        surface: &Surface,
        motion: &PadMotion,
        contact: &PadContact,
        (reference, radius): (Vector3<f64>, f64),
        friction_coefficient: f64,
    ) -> Self {
        let under = surface.query_face(&motion.at(&reference));
        let tangential = motion.linear - under.normal * under.normal.dot(&motion.linear);
        let normal_force = contact.force.dot(&under.normal);
        let tangential_force = (contact.force - under.normal * normal_force).norm();
        Self {
            time_s,
            point: under.point,
            normal: under.normal,
            curvature: under.curvature,
            distance_m: under.distance - radius,
            in_contact: contact.load > 0.0,
            load_n: contact.load,
            penetration_m: contact.depth,
            wrench: Wrench::new(contact.force, contact.torque),
            base_from_tool: Pose::new(motion.origin, motion.rotation),
            twist: Twist::new(motion.linear, motion.angular),
            sliding_speed_m_per_s: tangential.norm(),
            friction_ratio: if normal_force > 0.0 {
                tangential_force / normal_force
            } else {
                0.0
            },
            friction_coefficient,
            world_from_base: Pose::identity(),
        }
    }
}
