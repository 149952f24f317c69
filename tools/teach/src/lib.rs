//! A task from poses of the arm that a person shows by hand.
//!
//! [`Guide`] keeps the arm free to be moved, [`ArmReader`] reads where it stands, [`Lesson`]
//! collects points and strokes by keys, and [`draft`] makes a task file of them: a path in the
//! plane of the first point, and the start pose above it. `tangent teach` reads the keys and writes
//! the file.

mod arm_reader;
mod draft;
mod error;
mod guide;
mod lesson;
mod start_pose;
mod stroke;

pub use arm_reader::ArmReader;
pub use draft::{Draft, DraftOptions, Shape, draft};
pub use error::TeachError;
pub use guide::Guide;
pub use lesson::{Key, Lesson, Pressed, Shown};
