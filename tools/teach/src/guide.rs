//! Keeps the arm free to be moved by hand, until it is dropped.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use tangent_runtime::{Bus, Stop};
use tangent_schemas::tangent::Request;

use crate::error::TeachError;

/// Interval of the signs of life: the bridge waits for 2 s.
const KEEP: Duration = Duration::from_millis(400);
/// Timeout of an answer.
const ANSWER: Duration = Duration::from_secs(1);

/// A hand guides the arm while this exists and [`Guide::keep`] is called: the bridge ends it 2 s
/// after the last sign of life.
pub struct Guide {
    link: Link,
    /// The bridge has ended it: there is nothing to end.
    is_over: AtomicBool,
}

/// Where guiding is asked for, and by whom.
struct Link {
    bus: Bus,
    key: String,
    name: String,
}

impl Guide {
    /// Asks the bridge `service` (`rtde` or `franka`) to let a hand guide the arm, on behalf of the
    /// client `name` (1 to 64 bytes).
    ///
    /// # Errors
    /// The bridge's reason for not doing so.
    pub fn begin(bus: &Bus, service: &str, name: &str) -> Result<Self, TeachError> {
        let link = Link {
            bus: bus.clone(),
            key: format!("{service}/guide"),
            name: name.to_owned(),
        };
        match link.ask("begin") {
            Ok(()) => Ok(Self {
                link,
                is_over: AtomicBool::new(false),
            }),
            // If only the answer was lost, the bridge ends it by itself.
            Err(Failed::Refused(reason) | Failed::Silent(reason)) => {
                Err(TeachError::NotGuided(reason))
            }
        }
    }

    /// A sign of life. A bridge that does not answer is asked again with the next one.
    ///
    /// # Errors
    /// The bridge's reason for having ended it.
    pub fn keep(&self) -> Result<(), String> {
        match self.link.ask("keep") {
            Err(Failed::Refused(reason)) => {
                self.leave();
                Err(reason)
            }
            Ok(()) | Err(Failed::Silent(_)) => Ok(()),
        }
    }

    /// The bridge is not asked to end it, when this is dropped: it has done so.
    pub(crate) fn leave(&self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

impl Link {
    fn ask(&self, action: &str) -> Result<(), Failed> {
        let request = Request {
            action: action.to_owned(),
            argument: self.name.clone(),
        };
        match self.bus.ask(&self.key, &request, ANSWER) {
            Ok(answer) if answer.done => Ok(()),
            Ok(answer) => Err(Failed::Refused(answer.message)),
            Err(error) => Err(Failed::Silent(error.to_string())),
        }
    }
}

impl Drop for Guide {
    fn drop(&mut self) {
        if !self.is_over.load(Ordering::Relaxed) {
            // Without an answer, the bridge ends it by itself after two seconds.
            let _ = self.link.ask("end");
        }
    }
}

enum Failed {
    Refused(String),
    Silent(String),
}

/// A guide with a thread for its signs of life.
pub struct KeptGuide {
    stop: Stop,
    lost: Arc<Mutex<Option<String>>>,
    keeper: Option<JoinHandle<()>>,
}

impl KeptGuide {
    /// Asks the bridge `service` to let a hand guide the arm, and stays alive until it is dropped.
    ///
    /// # Errors
    /// As [`Guide::begin`]; or the thread cannot be started.
    pub fn begin(bus: &Bus, service: &str) -> Result<Self, TeachError> {
        let name = format!("teach/{}", std::process::id());
        let guide = Guide::begin(bus, service, &name)?;
        let (stop, lost) = (Stop::new(), Arc::new(Mutex::new(None)));
        let keeper = std::thread::Builder::new().name("guide".into());
        let keeper = keeper.spawn({
            let (stop, lost) = (stop.clone(), Arc::clone(&lost));
            move || {
                while !stop.wait(KEEP) {
                    if let Err(reason) = guide.keep() {
                        *lost.lock().unwrap_or_else(PoisonError::into_inner) = Some(reason);
                        return;
                    }
                }
            }
        });
        let keeper = keeper.map_err(|error| TeachError::NotGuided(error.to_string()))?;
        Ok(Self {
            stop,
            lost,
            keeper: Some(keeper),
        })
    }

    /// Why the arm cannot be guided any more, once.
    pub fn take_lost(&self) -> Option<String> {
        self.lost
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }
}

impl Drop for KeptGuide {
    fn drop(&mut self) {
        self.stop.trigger();
        // The guide is dropped with its thread.
        if let Some(keeper) = self.keeper.take() {
            let _ = keeper.join();
        }
    }
}
