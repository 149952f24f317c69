//! The thread that writes the memory down: a write waits for the disk.

use std::sync::Arc;
use std::thread::JoinHandle;

use tangent_runtime::{Handle, Stop};

use crate::memory::Memory;

/// Writes the memory down, and keeps `netft/tare` answered, until it is ended or dropped.
pub struct Keeper {
    ending: Stop,
    thread: Option<JoinHandle<()>>,
    _answering: Handle,
}

impl Keeper {
    pub(crate) fn start(memory: Arc<Memory>, answering: Handle) -> std::io::Result<Self> {
        let ending = Stop::new();
        let until = ending.clone();
        let thread = std::thread::Builder::new()
            .name("tare-memory".into())
            .spawn(move || memory.follow(&until))?;
        Ok(Self {
            ending,
            thread: Some(thread),
            _answering: answering,
        })
    }
}

impl Drop for Keeper {
    /// What came last is on the disk afterwards.
    fn drop(&mut self) {
        self.ending.trigger();
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join)
            && !std::thread::panicking()
        {
            std::panic::resume_unwind(panic);
        }
    }
}
