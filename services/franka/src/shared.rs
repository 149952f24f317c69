//! What the service's threads tell each other: only atomics and bounded lock-free queues, so the loop never waits.

use std::sync::atomic::{AtomicBool, AtomicU64};

use crossbeam_queue::ArrayQueue;
use tangent_schemas::Text;

/// What a person asks of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LoopRequest {
    /// See [`crate::bridge::Bridge::recover`].
    Recover,
    /// See [`crate::bridge::Bridge::stop`].
    Stop,
    /// Take the mean of the wrench from now on for its zero.
    Tare,
}

/// A line for the log, written by another thread than the one it comes from.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Note {
    Info(Text),
    Warning(Text),
    Refused(Text),
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Shared {
    pub requests: ArrayQueue<LoopRequest>,
    pub notes: ArrayQueue<Note>,
    /// Tares done since the start.
    pub tares: AtomicU64,
    /// The loop's thread has ended.
    pub ended: AtomicBool,
}

impl Shared {
    pub fn new() -> Self {
        Self {
            requests: ArrayQueue::new(8),
            notes: ArrayQueue::new(64),
            tares: AtomicU64::new(0),
            ended: AtomicBool::new(false),
        }
    }
}
