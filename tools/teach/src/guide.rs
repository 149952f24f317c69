//! Keeps the arm free to be moved by hand, until it is dropped.

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

/// A hand guides the arm while this exists.
pub struct Guide {
    bus: Bus,
    key: String,
    name: String,
    stop: Stop,
    lost: Arc<Mutex<Option<String>>>,
    keeper: Option<JoinHandle<()>>,
}

impl Guide {
    /// Asks the bridge `service` (`rtde` or `franka`) to let a hand guide the arm.
    ///
    /// # Errors
    /// The bridge's reason for not doing so.
    pub fn begin(bus: &Bus, service: &str) -> Result<Self, TeachError> {
        let (key, name) = (
            format!("{service}/guide"),
            format!("teach/{}", std::process::id()),
        );
        ask(bus, &key, "begin", &name).map_err(|failed| {
            let (Failed::Refused(reason) | Failed::Silent(reason)) = failed;
            TeachError::NotGuided(reason)
        })?;
        let (stop, lost) = (Stop::new(), Arc::new(Mutex::new(None)));
        let mut guide = Self {
            bus: bus.clone(),
            key,
            name,
            stop,
            lost,
            keeper: None,
        };
        let (bus, key, name) = (guide.bus.clone(), guide.key.clone(), guide.name.clone());
        let (stop, lost) = (guide.stop.clone(), Arc::clone(&guide.lost));
        let keeper = std::thread::Builder::new().name("guide".into());
        let spawned = keeper.spawn(move || {
            while !stop.wait(KEEP) {
                // Without an answer it tries again: a bridge that has ended it says so.
                if let Err(Failed::Refused(reason)) = ask(&bus, &key, "keep", &name) {
                    *lost.lock().unwrap_or_else(PoisonError::into_inner) = Some(reason);
                    return;
                }
            }
        });
        match spawned {
            Ok(keeper) => guide.keeper = Some(keeper),
            Err(error) => return Err(TeachError::NotGuided(error.to_string())),
        }
        Ok(guide)
    }

    /// Why the arm cannot be guided any more, once.
    pub fn take_lost(&self) -> Option<String> {
        self.lost
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }
}

impl Drop for Guide {
    fn drop(&mut self) {
        self.stop.trigger();
        if let Some(keeper) = self.keeper.take() {
            let _ = keeper.join();
        }
        // Without an answer, the bridge ends it by itself after two seconds.
        let _ = ask(&self.bus, &self.key, "end", &self.name);
    }
}

enum Failed {
    Refused(String),
    Silent(String),
}

fn ask(bus: &Bus, key: &str, action: &str, name: &str) -> Result<(), Failed> {
    let request = Request {
        action: action.to_owned(),
        argument: name.to_owned(),
    };
    match bus.ask(key, &request, ANSWER) {
        Ok(answer) if answer.done => Ok(()),
        Ok(answer) => Err(Failed::Refused(answer.message)),
        Err(error) => Err(Failed::Silent(error.to_string())),
    }
}
