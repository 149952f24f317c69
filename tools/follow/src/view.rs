//! What somebody who follows a task is told.

use std::time::Duration;

use tangent_schemas::tangent::{ContactTruth, ControlState};

/// Shows a task that is followed. All calls come from the thread that calls
/// [`follow()`](crate::follow()), in the order of the events.
pub trait FollowView {
    /// The task cannot be started yet, for this reason. Called when the reason changes.
    fn waiting(&mut self, reason: &str);

    /// A message of the cell, or what is being done.
    fn say(&mut self, text: &str);

    /// The controller's newest state, and the time since it arrived. `truth` is what a simulated
    /// cell knows about the contact. Called every 50 ms, also when nothing has changed.
    fn show(&mut self, control: &ControlState, age: Duration, truth: Option<&ContactTruth>);
}
