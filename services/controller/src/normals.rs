//! Tasks of the hybrid admittance: made ready for the loop, with the normal estimators that they name.

use std::sync::{Mutex, MutexGuard, PoisonError};

use tangent_control::{ControllerConfig, EstimatorName, Program, Task};
use tangent_runtime::{Bus, BusError, Latest};
use tangent_schemas::tangent::NormalEstimate;
use tangent_schemas::topics;

use crate::desk::{FIRST_ESTIMATE, FRESH, Kind, NO_LOOP};
use crate::inputs::EstimateReader;
use crate::mailbox::{Ask, Mailbox};

/// See the module.
pub struct Normals {
    bus: Bus,
    config: ControllerConfig,
    estimates: Mutex<Vec<(String, Latest<NormalEstimate>)>>,
}

impl Normals {
    /// Listens to `estimators`; `config` is for tasks that name no preset.
    pub fn new(
        bus: &Bus,
        config: ControllerConfig,
        estimators: &[String],
    ) -> Result<Self, BusError> {
        let estimates = estimators
            .iter()
            .map(|name| Ok((name.clone(), bus.latest(&topics::estimate_normal(name))?)))
            .collect::<Result<_, BusError>>()?;
        Ok(Self {
            bus: bus.clone(),
            config,
            estimates: Mutex::new(estimates),
        })
    }

    fn estimates(&self) -> MutexGuard<'_, Vec<(String, Latest<NormalEstimate>)>> {
        self.estimates
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kind for Normals {
    type Program = Program;

    fn prepare(&self, text: &str) -> Result<(String, Program), String> {
        text.parse::<Task>()
            .and_then(|task| Program::new(&task, &self.config))
            .map(|program| (program.task.name.clone(), program))
            .map_err(|error| error.to_string())
    }

    fn check_estimates(&self, program: &Program, mailbox: &Mailbox<Program>) -> Result<(), String> {
        for name in &program.estimators {
            self.hear(name, mailbox)?;
        }
        let fresh = |(name, newest): &mut (String, Latest<NormalEstimate>)| {
            program.estimators.iter().any(|n| n.as_str() == name) && newest.fresh(FRESH).is_some()
        };
        if self.estimates().iter_mut().any(fresh) {
            return Ok(());
        }
        Err(format!(
            "none of the task's estimators publishes: {}; is the estimator running, with these in [estimators] run?",
            program.task.estimators.join(", ")
        ))
    }

    /// Has the desk and the loop read this estimator's topic, and waits for its first word.
    fn hear(&self, name: &EstimatorName, mailbox: &Mailbox<Program>) -> Result<(), String> {
        let topic = topics::estimate_normal(name);
        {
            let mut estimates = self.estimates();
            if estimates.iter().any(|(known, _)| known == name.as_str()) {
                return Ok(());
            }
            let newest = self.bus.latest(&topic).map_err(|e| e.to_string())?;
            estimates.push((name.to_string(), newest));
        }
        let newest = self.bus.latest(&topic).map_err(|e| e.to_string())?;
        let reader = EstimateReader::new(*name, newest);
        mailbox
            .ask(Ask::Listen(Box::new(Some(reader))))
            .ok_or_else(|| NO_LOOP.to_owned())?;
        let first = self.bus.subscribe(&topic, 1).map_err(|e| e.to_string())?;
        // Nobody there is no error here: another of the list may be.
        let _ = first.recv_timeout(FIRST_ESTIMATE);
        Ok(())
    }
}
