//! A pad of points on a surface: Hunt-Crossley along the normal, friction with bristles across it.

mod friction;
mod normal_force;
mod pad;

pub use friction::Friction;
pub use normal_force::HuntCrossley;
pub use pad::{Pad, PadContact, PadLinearisation, PadMotion};
