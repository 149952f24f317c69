//! What the service's threads tell each other: only atomics and bounded lock-free queues between them and the loop, which never waits.

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use crossbeam_queue::ArrayQueue;
use tangent_runtime::ticket::Ticket;
use tangent_schemas::Text;

use crate::tare::ZeroTooLarge;

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
    /// A person asks for [`crate::bridge::Bridge::recover`].
    pub recover_asked: AtomicBool,
    /// A person asks for [`crate::bridge::Bridge::stop`].
    pub stop_asked: AtomicBool,
    /// The mean of the wrench becomes its zero.
    pub tare: Ticket,
    /// Held by the one that asks for a tare.
    pub tare_turn: Mutex<()>,
    pub notes: ArrayQueue<Note>,
    /// How the last tare ended.
    pub tared: ArrayQueue<Result<(), ZeroTooLarge>>,
    /// The loop's thread has ended.
    pub ended: AtomicBool,
}

impl Shared {
    pub fn new() -> Self {
        Self {
            recover_asked: AtomicBool::new(false),
            stop_asked: AtomicBool::new(false),
            tare: Ticket::default(),
            tare_turn: Mutex::new(()),
            notes: ArrayQueue::new(64),
            tared: ArrayQueue::new(1),
            ended: AtomicBool::new(false),
        }
    }
}
