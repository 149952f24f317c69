//! What the service's threads tell each other: only atomics and bounded lock-free queues, so the loop never waits.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::thread::Thread;

use crossbeam_queue::ArrayQueue;
use tangent_schemas::Text;

use crate::codec::{Series, TextMessage};

/// The program has to go to the robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Upload {
    pub session: i32,
    pub series: Series,
}

/// A line for the log, written by another thread than the one it comes from.
#[derive(Clone, Debug)]
pub(crate) enum Note {
    /// What the robot says.
    Robot(TextMessage),
    Info(Text),
    Warning(Text),
    Refused(Text),
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Shared {
    /// A person asks for [`crate::bridge::Bridge::reset`].
    pub reset_asked: AtomicBool,
    /// A person asks for [`crate::bridge::Bridge::stop`].
    pub stop_asked: AtomicBool,
    pub uploads: ArrayQueue<Upload>,
    pub notes: ArrayQueue<Note>,
    /// Thread of the set-up; woken when there is an upload.
    pub setup: OnceLock<Thread>,
    /// Counts connections whose version is known and good.
    pub links: AtomicU64,
    pub robot_mode: AtomicI32,
    pub safety_mode: AtomicI32,
    pub wrong_model: AtomicBool,
    pub power_on_asked: AtomicBool,
    /// The loop's thread has ended.
    pub ended: AtomicBool,
}

impl Shared {
    pub fn new() -> Self {
        Self {
            reset_asked: AtomicBool::new(false),
            stop_asked: AtomicBool::new(false),
            uploads: ArrayQueue::new(2),
            notes: ArrayQueue::new(64),
            setup: OnceLock::new(),
            links: AtomicU64::new(0),
            robot_mode: AtomicI32::new(-1),
            safety_mode: AtomicI32::new(0),
            wrong_model: AtomicBool::new(false),
            power_on_asked: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        }
    }

    pub fn upload(&self, upload: Upload) {
        self.uploads.force_push(upload);
        self.wake_setup();
    }

    pub fn wake_setup(&self) {
        if let Some(thread) = self.setup.get() {
            thread.unpark();
        }
    }

    pub fn has_ended(&self) -> bool {
        self.ended.load(Ordering::Acquire)
    }
}
