//! Checks the files of a cell offline, by every rule that would be applied later.
//!
//! [`check_file`] reads a cell, a task, a scenario or a robot model, and asks each service that
//! would use it, so that no rule is duplicated here. It returns [`Findings`]: errors, each with
//! key, value, what is allowed and what to do, and notes on what is accepted or cannot be checked
//! offline. A task is checked on a cell, [`OnCell`]. `tangent check` prints the findings;
//! `tangent up` calls [`before_start`].

mod cell;
mod error;
mod file;
mod findings;
mod kind;
mod on_cell;
mod task;

pub use error::CheckError;
pub use file::check_file;
pub use findings::Findings;
pub use kind::FileKind;
pub use on_cell::OnCell;
pub use task::before_start;
