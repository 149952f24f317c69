//! Frames as types: a pose composes only with a pose that starts where it ends.

mod frame;
mod pose;
mod twist;
mod wrench;

pub use frame::{Aligned, Base, Camera, Contact, Flange, Frame, Object, Sensor, Tool, World};
pub use pose::Pose;
pub use twist::Twist;
pub use wrench::Wrench;
