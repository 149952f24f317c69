//! Reports on a task to an operator who follows it.

use std::time::Duration;

use tangent_schemas::tangent::{ContactTruth, ControlState};

/// Shows a task that is followed. All calls come from the thread that calls
/// [`follow()`](crate::follow()), in the order of the events.
pub trait FollowView {
    /// The task cannot be started yet, for this reason. Called when the reason changes.
    fn waiting(&mut self, reason: &str);

    /// A message of the cell, or a step of this command.
    fn say(&mut self, text: &str);

    /// The controller's newest state, and the time since it arrived. `truth` is the true contact of
    /// a simulated cell. Called every 50 ms, also if nothing has changed.
    fn show(&mut self, control: &ControlState, age: Duration, truth: Option<&ContactTruth>);
}
