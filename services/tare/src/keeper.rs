//! Thread that stores the memory on the disk, so that the service's loop never waits for the disk.

use std::sync::Arc;
use std::thread::JoinHandle;

use tangent_runtime::{Handle, Stop};

use crate::memory::Memory;

/// Stores the memory and keeps `netft/tare` answered until it is dropped.
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
    /// Stores the last state, then ends the thread.
    fn drop(&mut self) {
        self.ending.trigger();
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join)
            && !std::thread::panicking()
        {
            std::panic::resume_unwind(panic);
        }
    }
}
