//! A service in a thread of this process.

use std::error::Error;
use std::thread::JoinHandle;

use tangent_runtime::Stop;

use crate::error::{ComposeError, with_causes};

/// Result with which a service ends.
pub type Ended = Result<(), Box<dyn Error + Send + Sync>>;

/// A service running in a thread of this process.
pub struct Running {
    name: &'static str,
    stop: Stop,
    thread: JoinHandle<Ended>,
}

impl Running {
    /// Starts `body` in a thread. The thread ends when its own [`Stop`] is triggered. If it ends
    /// for another reason, it triggers `process_stop`, so that no service continues without it. A
    /// panic in it ends the process, see [`tangent_runtime::ending`].
    ///
    /// # Errors
    /// The system cannot start another thread.
    pub fn start(
        name: &'static str,
        process_stop: &Stop,
        body: impl FnOnce(Stop) -> Ended + Send + 'static,
    ) -> Result<Self, ComposeError> {
        let stop = Stop::new();
        let (own, process_stop) = (stop.clone(), process_stop.clone());
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                let mut ended = body(own.clone());
                if ended.is_ok() && !own.is_stopped() && !process_stop.is_stopped() {
                    ended = Err("ended by itself; this is a defect".into());
                }
                if let Err(error) = &ended {
                    let error = with_causes(error.as_ref());
                    tracing::error!("{name}: {error}; all services of this process end");
                    process_stop.trigger();
                }
                ended
            })
            .map_err(|source| ComposeError::Thread { what: name, source })?;
        Ok(Self { name, stop, thread })
    }

    /// Ends the service and waits for it.
    ///
    /// # Errors
    /// The error with which the service ended.
    pub fn end(self) -> Result<(), ComposeError> {
        self.stop.trigger();
        self.thread
            .join()
            .unwrap_or_else(|_| Err("panicked; this is a defect".into()))
            .map_err(|source| ComposeError::Failed {
                name: self.name,
                source,
            })
    }
}
