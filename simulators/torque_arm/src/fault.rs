//! Faults that a request can inject.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use tangent_runtime::clock::now_ns;
use tangent_schemas::tangent::{Answer, Request};

/// Faults in force, shared with the thread of the arm.
#[derive(Default)]
pub(crate) struct Faults {
    /// The camera takes no images.
    pub camera_off: AtomicBool,
    /// No `arm/state` is published until this time, ns on the wall clock.
    pub frozen_until_ns: AtomicU64,
    /// The emergency stop is pressed.
    pub stopped: AtomicBool,
}

impl Faults {
    /// Injects or ends the fault that the request names.
    pub fn answer(&self, request: &Request) -> Answer {
        let switch = match request.argument.trim() {
            "" | "on" => Some(true),
            "off" => Some(false),
            _ => None,
        };
        let seconds = request.argument.trim().parse::<f64>().ok();
        let done = |message: String| Answer {
            done: true,
            message,
            ..Answer::default()
        };
        match (request.action.as_str(), switch, seconds) {
            ("camera", Some(on), _) => {
                self.camera_off.store(!on, Ordering::Release);
                done(format!("camera on: {on}"))
            }
            ("emergency_stop", Some(pressed), _) => {
                self.stopped.store(pressed, Ordering::Release);
                done(format!("emergency stop pressed: {pressed}"))
            }
            ("freeze", _, Some(s)) if (0.0..=3600.0).contains(&s) => {
                let until = now_ns() + (s * 1e9) as i64;
                self.frozen_until_ns
                    .store(until.unsigned_abs(), Ordering::Release);
                done(format!("no arm/state for {s} s"))
            }
            (name, ..) => Answer {
                done: false,
                message: format!(
                    "\"{name}\" with {:?} is not a fault of this cell; the faults are: camera on|off, emergency_stop \
                     on|off, freeze SECONDS (0 to 3600)",
                    request.argument
                ),
                ..Answer::default()
            },
        }
    }
}
