//! Contact of a tool's pad with a surface: the part that the plants of all systems have in common.

use nalgebra::Vector3;
use tangent_mechanics::{Base, Pose, Tip, Tool};

use crate::contact::{
    Compliance, ContactConfig, FrictionVariation, Obstacle, Pad, PadConfig, PadContact, PadMotion,
    Placed,
};
use crate::surfaces::{Surface, SurfaceConfig, SurfaceError};
use crate::tool::ToolConfig;
use crate::truth::Truth;

/// Pad, surface, and the contact between them.
#[derive(Clone, Debug)]
pub(crate) struct Touch {
    /// The surface.
    pub surface: Surface,
    pad: Pad,
    compliance: Option<Compliance>,
    obstacle: Option<Placed>,
    /// Force of a person's hand on the tool, base axes, N.
    hand: Vector3<f64>,
    friction_coefficient: f64,
    /// The pad's motion, with the deflection of the tool.
    pub motion: PadMotion,
    /// Forces on the pad.
    pub contact: PadContact,
}

impl Touch {
    /// Creates the pad at the origin of the base, until [`Touch::place_tool`] is called.
    ///
    /// # Errors
    /// A dimension of the surface is out of its range.
    pub fn new(
        surface: &SurfaceConfig,
        tool: &ToolConfig,
        contact: &ContactConfig,
    ) -> Result<Self, SurfaceError> {
        let pad_stiffness = match &tool.compliance {
            None => contact.stiffness_n_per_m,
            Some(c) => 1.0 / (1.0 / contact.stiffness_n_per_m - 1.0 / c.stiffness_n_per_m[2]),
        };
        let disk = |radius_m, hollow| PadConfig {
            radius_m,
            rings: 2,
            hollow,
            crown_radius_m: None,
        };
        let pad = match tool.tip {
            None | Some(Tip::Unknown) => Pad::new(&tool.pad, contact, pad_stiffness),
            Some(Tip::Flat { radius_m }) => {
                Pad::new(&disk(radius_m, false), contact, pad_stiffness)
            }
            Some(Tip::Ring { radius_m }) => Pad::new(&disk(radius_m, true), contact, pad_stiffness),
            Some(Tip::Round { radius_m }) => Pad::ball(radius_m, contact, pad_stiffness),
            Some(Tip::Soft { radius_m }) => {
                let series = 1.0 / (1.0 / pad_stiffness + 1.0 / tool.soft_stiffness_n_per_m);
                Pad::soft(&disk(radius_m, false), contact, series)
            }
        };
        Ok(Self {
            surface: Surface::new(&surface.shape, &surface.pose())?,
            pad,
            compliance: tool.compliance.as_ref().map(Compliance::new),
            obstacle: None,
            hand: Vector3::zeros(),
            friction_coefficient: contact.friction.coulomb_coefficient,
            motion: PadMotion::at_rest(&Pose::identity()),
            contact: PadContact::none(),
        })
    }

    /// Places the tool at rest in a pose, without contact.
    pub fn place_tool(&mut self, base_from_tool: &Pose<Base, Tool>) {
        self.motion = PadMotion::at_rest(base_from_tool);
        self.contact = PadContact::none();
    }

    /// One sub-step of `dt` (s). `rigid` is the motion that the pad would have on a rigid tool.
    pub fn step(&mut self, rigid: PadMotion, dt: f64) {
        (self.contact, self.motion) = match &mut self.compliance {
            None => (self.pad.step(&self.surface, &rigid, dt, None), rigid),
            Some(compliance) => compliance.step(&mut self.pad, &self.surface, &rigid, dt),
        };
        if let Some(obstacle) = &self.obstacle {
            obstacle.push(&self.motion.origin, &mut self.contact);
        }
        self.contact.force += self.hand;
    }

    /// Lets the friction vary along the surface.
    pub fn vary_friction(&mut self, variation: FrictionVariation) {
        self.pad.vary_friction(variation);
    }

    /// Normal of the surface under the tool, base axes, out of the material.
    pub fn normal(&self) -> Vector3<f64> {
        let (reference, _) = self.pad.reference();
        let at = self.motion.at(&reference);
        self.surface.distance_and_normal(&at).1
    }

    /// Puts an obstacle in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.obstacle = Some(Placed::new(obstacle, self.motion.origin, self.normal()));
    }

    /// Pushes on the tool's origin with a force (base axes, N) from now on.
    pub fn push_by_hand(&mut self, force: Vector3<f64>) {
        self.hand = force;
    }

    /// True state of the contact at `time_s`.
    pub fn truth(&self, time_s: f64) -> Truth {
        Truth::of(
            time_s,
            &self.surface,
            &self.motion,
            &self.contact,
            self.pad.reference(),
            self.friction_coefficient,
        )
    }
}
