//! The points that a depth camera at the flange sees, in the base of the robot: from a running
//! cell, or from a recording.
//!
//! Both sources pass `camera/depth`, `camera/info` and `arm/state` to one [`Fuse`], which places
//! each image with the pose of the tool at its stamp. `tangent scan` calls [`LiveScan`] and
//! [`of_recording`], `tangent region` only the latter.

mod error;
mod frames;
mod fuse;
mod image;
mod live;
mod mounting;
mod poses;
mod recording;
mod scan;
mod tally;
#[cfg(test)]
mod testing;

pub use error::ScanError;
pub use fuse::Fuse;
pub use live::{LiveScan, Seen};
pub use mounting::Mounting;
pub use recording::of_recording;
pub use scan::Scan;
pub use tally::Tally;
