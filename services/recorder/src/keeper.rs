//! Maintains the folder while recordings are written: repairs files that a crash left truncated,
//! and deletes the oldest recordings beyond the configured limits. It has its own thread, so
//! recording never waits for it.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use tangent_runtime::Stop;

use crate::config::RecorderConfig;
use crate::error::RecorderError;
use crate::files::free_bytes;
use crate::repair::{self, Bounds, Repair};
use crate::retention::{self, Budget};

/// Interval of regular checks of the folder.
const LOOK: Duration = Duration::from_secs(60);

/// Handle of the thread. Dropping it ends the thread.
pub(crate) struct Keeper {
    stop: Stop,
    wake: Option<Sender<()>>,
    mended: Receiver<Repair>,
    thread: Option<JoinHandle<()>>,
}

impl Keeper {
    /// Starts the thread for the folder of `config`, which must exist.
    pub(crate) fn start(config: &RecorderConfig) -> Result<Self, RecorderError> {
        let stop = Stop::new();
        let (wake, woken) = channel();
        let (found, mended) = channel();
        let mut round = Round {
            folder: config.folder.clone(),
            budget: Budget::of(config),
            free_min_bytes: config.free_min_bytes,
            stop: stop.clone(),
            mended: found,
            said: None,
        };
        let thread = std::thread::Builder::new()
            .name("recorder-keep".to_owned())
            .spawn(move || {
                loop {
                    round.run();
                    match woken.recv_timeout(LOOK) {
                        Ok(()) | Err(RecvTimeoutError::Timeout) => {}
                        Err(RecvTimeoutError::Disconnected) => return,
                    }
                }
            })
            .map_err(|source| RecorderError::Thread { source })?;
        Ok(Self {
            stop,
            wake: Some(wake),
            mended,
            thread: Some(thread),
        })
    }

    /// Notifies the thread that the folder has changed: a file was closed or given up.
    pub(crate) fn look(&self) {
        if let Some(wake) = &self.wake {
            // If the thread has ended, the folder is not maintained; the recording continues.
            let _ = wake.send(());
        }
    }

    /// Files repaired since the last call.
    pub(crate) fn mended(&self) -> impl Iterator<Item = Repair> + '_ {
        self.mended.try_iter()
    }

    /// Ends the thread at once: a file under repair stays truncated, and the incomplete copy is
    /// removed.
    pub(crate) fn finish(&mut self) {
        self.stop.trigger();
        self.wake = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that keeps the recordings' folder in order panicked");
        }
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.finish();
    }
}

struct Round {
    folder: PathBuf,
    budget: Budget,
    free_min_bytes: u64,
    stop: Stop,
    mended: Sender<Repair>,
    /// The error reported last, so that it is reported once.
    said: Option<String>,
}

impl Round {
    fn run(&mut self) {
        let mut trouble = Vec::new();
        if let Err(error) = repair::clear_mends(&self.folder) {
            trouble.push(error.to_string());
        }
        self.delete(&mut trouble);
        match repair::torn_files(&self.folder) {
            Ok(torn) => {
                for path in torn {
                    if self.stop.is_stopped() {
                        return;
                    }
                    match self.mend(&path) {
                        Ok(one) => {
                            tracing::warn!(
                                "{} had no end (its recorder was killed): repaired, {} messages kept, {} bytes cut off; \
                                 the original is beside it with the ending .torn",
                                one.path.display(),
                                one.messages,
                                one.bytes_cut
                            );
                            let _ = self.mended.send(one);
                            self.delete(&mut trouble);
                        }
                        Err(RecorderError::Stopped { path }) => {
                            return tracing::info!(
                                "{} is not repaired yet: the repair was stopped",
                                path.display()
                            );
                        }
                        Err(error) => trouble.push(error.to_string()),
                    }
                }
            }
            Err(error) => trouble.push(error.to_string()),
        }
        let trouble = (!trouble.is_empty()).then(|| trouble.join("; "));
        if trouble != self.said {
            if let Some(trouble) = &trouble {
                tracing::error!("{trouble}");
            }
            self.said = trouble;
        }
    }

    fn delete(&self, trouble: &mut Vec<String>) {
        if let Err(error) = retention::apply(&self.folder, self.budget, SystemTime::now()) {
            trouble.push(error.to_string());
        }
    }

    fn mend(&self, path: &std::path::Path) -> Result<Repair, RecorderError> {
        repair::repair_within(
            path,
            &Bounds {
                free_min_bytes: self.free_min_bytes,
                free: &free_bytes,
                stop: &self.stop,
                gently: true,
            },
        )
    }
}
