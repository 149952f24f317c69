//! The dose that the running task asks for: `[coverage]` of its file, which the controller shows.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde::Deserialize;
use tangent_control::Task;
use tangent_runtime::Bus;
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::queries;

use crate::lock;

/// Time that the controller has to answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// Band of the dose of the newest task.
#[derive(Clone, Default)]
pub struct TaskBand(Arc<Mutex<Known>>);

#[derive(Default)]
struct Known {
    activation: u64,
    band: Option<[f64; 2]>,
}

impl TaskBand {
    /// The band that the task states, N*s/cm²; `None` if it states none, or is not known yet.
    pub fn get(&self) -> Option<[f64; 2]> {
        lock(&self.0).band
    }

    /// A task began: asks the controller for its file, in a thread of its own.
    pub fn learn(&self, bus: &Bus, activation: u64) {
        *lock(&self.0) = Known {
            activation,
            band: None,
        };
        let (bus, known) = (bus.clone(), Arc::clone(&self.0));
        let asking = std::thread::Builder::new().name("ui-task".to_owned());
        let started = asking.spawn(move || {
            let band = asked(&bus);
            let mut known = lock(&known);
            // Another task may have begun meanwhile.
            if known.activation == activation {
                known.band = band;
            }
        });
        if let Err(error) = started {
            tracing::warn!("the task's dose is not known: {error}");
        }
    }
}

fn asked(bus: &Bus) -> Option<[f64; 2]> {
    let request = Request {
        action: "show".to_owned(),
        argument: String::new(),
    };
    let answer = bus.ask(queries::CONTROL_SHOW, &request, PATIENCE).ok()?;
    band_of(&answer.data)
}

/// The band in the controller's answer.
fn band_of(data: &str) -> Option<[f64; 2]> {
    #[derive(Deserialize)]
    struct Shown {
        task_toml: String,
    }
    let shown: Shown = serde_json::from_str(data).ok()?;
    let task: Task = shown.task_toml.parse().ok()?;
    task.coverage?.dose_n_s_per_cm2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_task_with_a_dose_has_a_band() {
        let shown = |text: &str| serde_json::json!({ "task_toml": text }).to_string();
        let region = include_str!("../../../deploy/tasks/region.toml");
        assert_eq!(band_of(&shown(region)), Some([0.8, 8.0]));
        let line = include_str!("../../../deploy/tasks/line.toml");
        assert_eq!(band_of(&shown(line)), None);
        assert_eq!(band_of(""), None);
    }
}
