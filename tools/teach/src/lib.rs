//! A task from poses of the arm that a person shows by hand.
//!
//! [`Guide`] keeps the arm free to be moved, [`ArmLesson`] reads where it stands and collects
//! points and strokes by keys, and [`draft`] makes a task file of them: a path in the plane of the
//! first point, and the start pose above it. `tangent teach` reads the keys and writes the file;
//! the operator's page does so through a [`Session`].

mod arm_lesson;
mod arm_reader;
mod draft;
mod error;
mod guide;
mod lesson;
mod session;
mod start_pose;

pub use arm_lesson::ArmLesson;
pub use draft::{CLEARANCE_M, Draft, DraftOptions, SPACING_M, Shape, TOLERANCE_M, draft};
pub use error::TeachError;
pub use guide::{Guide, KeptGuide};
pub use lesson::{Key, Lesson, Places, Pressed, Shown};
pub use session::{Bridge, Session, SessionState};
