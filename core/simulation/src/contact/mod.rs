//! Contact of a pad of points with a surface: Hunt-Crossley normal force, bristle friction in the
//! tangent plane.

mod compliance;
mod config;
mod friction;
mod friction_variation;
mod normal_force;
mod obstacle;
mod pad;

pub(crate) use compliance::Compliance;
pub use compliance::ComplianceConfig;
pub use config::ContactConfig;
pub use friction::{Friction, FrictionConfig, FrictionModel};
pub use friction_variation::FrictionVariation;
pub use normal_force::HuntCrossley;
pub use obstacle::Obstacle;
pub(crate) use obstacle::Placed;
pub use pad::{Pad, PadConfig, PadContact, PadLinearisation, PadMotion};
