//! State shared by the service's threads. The loop shares only atomics and bounded lock-free queues
//! with the others, so it never waits.

use std::sync::atomic::AtomicBool;

use crossbeam_queue::ArrayQueue;
use tangent_schemas::Text;

/// A log line that another thread writes.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Note {
    Info(Text),
    Warning(Text),
    Refused(Text),
}

/// Requests to the loop, its log lines, and the result of the last tare.
#[derive(Debug)]
pub(crate) struct Shared {
    /// An operator has requested [`crate::bridge::Bridge::recover`].
    pub recover_asked: AtomicBool,
    /// An operator has requested [`crate::bridge::Bridge::stop`].
    pub stop_asked: AtomicBool,
    pub notes: ArrayQueue<Note>,
    /// Whether the loop's thread has ended.
    pub ended: AtomicBool,
}

impl Shared {
    pub fn new() -> Self {
        Self {
            recover_asked: AtomicBool::new(false),
            stop_asked: AtomicBool::new(false),
            notes: ArrayQueue::new(64),
            ended: AtomicBool::new(false),
        }
    }
}
