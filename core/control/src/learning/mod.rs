//! Iterative learning: the surface under a path, learnt from earlier passes over the same part and
//! fed forward in the next one.
//!
//! A pass is one run of a task. While the tool slides, a [`Learner`] records where the surface was
//! and feeds forward what the [`Memory`] knows. After the pass, outside the robot's cycle,
//! [`Learner::finish`] returns the memory for the next one.

mod learner;
mod memory;
mod pass;
mod spec;
mod store;
mod trust;
mod update;

pub use learner::{EndedPass, Feedforward, Learner, PassSample};
pub use memory::{Memory, SurfacePoint};
pub use spec::LearningSpec;
pub use store::MemoryError;
