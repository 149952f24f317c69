//! Readings of a force sensor in several orientations of the arm, from which the payload on it is
//! identified.
//!
//! [`pose`] averages one pose of a running cell, [`recorded`] finds every pose in a recording at
//! which the arm stands still. `tangent_sensing::identify_payload` fits mass, centre of mass, zero
//! and mounting to them; [`warnings`] judges the fit against the cell file.
//! `tangent calibrate payload` asks for the poses and prints the result.

mod error;
mod live;
mod recorded;
mod warnings;

pub use error::CalibrateError;
pub use live::pose;
pub use recorded::recorded;
pub use warnings::{mounting_error_rad, warnings};
