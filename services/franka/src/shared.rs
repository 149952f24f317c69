//! State shared by the service's threads. The loop shares only atomics and bounded lock-free queues
//! with the others, so it never waits.

use std::sync::atomic::AtomicBool;

use tangent_runtime::robot_loop::Notes;

/// Requests to the loop, and its log lines.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    /// An operator has requested [`crate::bridge::Bridge::recover`].
    pub recover_asked: AtomicBool,
    /// An operator has requested [`crate::bridge::Bridge::stop`].
    pub stop_asked: AtomicBool,
    pub notes: Notes,
}
