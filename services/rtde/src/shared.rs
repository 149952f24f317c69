//! State shared by the service's threads: only atomics and bounded lock-free queues, so the loop
//! never waits.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::thread::Thread;

use tangent_runtime::ring::Ring;
use tangent_runtime::robot_loop::Notes;

use crate::codec::{Series, TextMessage};
use crate::guide_mailbox::GuideMailbox;

/// Request to send the program to the robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Upload {
    pub session: i32,
    pub series: Series,
}

/// Requests to the loop, its log lines, program uploads, and the state of the robot.
#[derive(Debug)]
pub(crate) struct Shared {
    /// An operator has requested [`crate::bridge::Bridge::reset`].
    pub reset_asked: AtomicBool,
    /// An operator has requested [`crate::bridge::Bridge::stop`].
    pub stop_asked: AtomicBool,
    /// Requests to guide the arm.
    pub guide: GuideMailbox,
    pub uploads: Ring<Upload>,
    pub notes: Notes<TextMessage>,
    /// Set-up thread, woken when there is an upload.
    pub setup: OnceLock<Thread>,
    /// Number of connections whose version is known and supported.
    pub links: AtomicU64,
    pub robot_mode: AtomicI32,
    pub safety_mode: AtomicI32,
    pub wrong_model: AtomicBool,
    pub power_on_asked: AtomicBool,
    /// Whether the loop's thread has ended.
    pub ended: AtomicBool,
}

impl Shared {
    pub fn new() -> Self {
        Self {
            reset_asked: AtomicBool::new(false),
            stop_asked: AtomicBool::new(false),
            guide: GuideMailbox::default(),
            uploads: Ring::new(2),
            notes: Notes::default(),
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
        self.uploads.force_push(upload, drop);
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
