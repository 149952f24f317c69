//! Prepares tasks of the hybrid admittance for the loop, with the normal estimators that they name.

use std::sync::{Mutex, MutexGuard, PoisonError};

use tangent_control::{ControllerConfig, EstimatorName, Program, Task};
use tangent_runtime::{Bus, BusError, Latest};
use tangent_schemas::tangent::NormalEstimate;
use tangent_schemas::topics;

use crate::config::Config;
use crate::inputs::EstimateReader;
use crate::mailbox::{Action, Mailbox, Time};
use crate::requests::{FRESH, Kind, one_speaks, silence_text};
use crate::start_check::StartCheck;

/// Prepares tasks of the hybrid admittance, and keeps the loop subscribed to their estimators.
pub struct Normals {
    bus: Bus,
    config: ControllerConfig,
    check: StartCheck<6>,
    estimates: Mutex<Vec<(String, Latest<NormalEstimate>)>>,
}

impl Normals {
    /// Subscribes to the estimators of the cell's configuration.
    pub fn new(bus: &Bus, config: &Config) -> Result<Self, BusError> {
        let estimates = config
            .estimators
            .iter()
            .map(|name| Ok((name.clone(), bus.latest(&topics::estimate_normal(name))?)))
            .collect::<Result<_, BusError>>()?;
        Ok(Self {
            bus: bus.clone(),
            config: config.control,
            check: StartCheck::new(
                bus,
                config.arm,
                config.flange_from_tool,
                config.limits,
                config.estimators.clone(),
            )?,
            estimates: Mutex::new(estimates),
        })
    }

    fn estimates(&self) -> MutexGuard<'_, Vec<(String, Latest<NormalEstimate>)>> {
        self.estimates
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Subscribes this service and the loop to the estimator's topic; false if they are already
    /// subscribed.
    fn listen(
        &self,
        name: &EstimatorName,
        mailbox: &Mailbox<Program>,
        time: Time,
    ) -> Result<bool, String> {
        let known = |estimates: &[(String, _)]| estimates.iter().any(|(n, _)| n == name.as_str());
        if known(&self.estimates()) {
            return Ok(false);
        }
        let topic = topics::estimate_normal(name);
        let newest = self.bus.latest(&topic).map_err(|e| e.to_string())?;
        let reader = EstimateReader::new(*name, newest);
        mailbox
            .ask(Action::Listen(Box::new(Some(reader))), time)
            .map_err(|silence| silence_text(silence).to_owned())?;
        // Only after the loop reads it: if the request was withdrawn, a later call repeats it.
        let newest = self.bus.latest(&topic).map_err(|e| e.to_string())?;
        let mut estimates = self.estimates();
        if !known(&estimates) {
            estimates.push((name.to_string(), newest));
        }
        Ok(true)
    }
}

impl Kind for Normals {
    type Program = Program;

    fn prepare(&self, text: &str) -> Result<(String, Program), String> {
        let program = text
            .parse::<Task>()
            .and_then(|task| Program::new(&task, &self.config))
            .map_err(|error| error.to_string())?;
        let task = &program.task;
        self.check.task(task, &program.path)?;
        self.check
            .estimators(&self.bus, &task.estimators, topics::estimate_normal)?;
        Ok((task.name.clone(), program))
    }

    fn leave(&self) -> Result<Program, String> {
        Program::new(&self.check.leave(), &self.config).map_err(|error| error.to_string())
    }

    fn check_estimates(
        &self,
        program: &Program,
        mailbox: &Mailbox<Program>,
        time: Time,
    ) -> Result<(), String> {
        let fresh = |(name, newest): &mut (String, Latest<NormalEstimate>)| {
            program.estimators.iter().any(|n| n.as_str() == name) && newest.fresh(FRESH).is_some()
        };
        let speaks = self.estimates().iter_mut().any(fresh) || {
            let topics = program.estimators.iter();
            one_speaks(&self.bus, topics.map(|name| topics::estimate_normal(name)))?
        };
        if !speaks {
            return Err(format!(
                "none of the task's estimators publishes: {}; is the estimator running, with these in [estimators] run?",
                program.task.estimators.join(", ")
            ));
        }
        for name in &program.estimators {
            self.listen(name, mailbox, time)?;
        }
        Ok(())
    }

    /// Subscribes this service and the loop to the estimator's topic, and waits for its first
    /// estimate.
    fn hear(
        &self,
        name: &EstimatorName,
        mailbox: &Mailbox<Program>,
        time: Time,
    ) -> Result<(), String> {
        if self.listen(name, mailbox, time)? {
            // An estimator without a publisher is no error here: the loop reports it.
            one_speaks(&self.bus, std::iter::once(topics::estimate_normal(name)))?;
        }
        Ok(())
    }
}
