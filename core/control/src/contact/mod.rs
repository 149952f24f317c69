//! Geometry of a contact, and energy tanks; shared by several laws.

pub mod alignment;
pub mod energy_tank;
