//! Prepares tasks of the hybrid admittance for the loop, with the normal estimators that they name.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tangent_control::{ControllerConfig, EstimatorName, LawConfig, Program, Task};
use tangent_mechanics::Tip;
use tangent_runtime::{Bus, BusError, Latest};
use tangent_schemas::tangent::NormalEstimate;
use tangent_schemas::topics;

use super::start_check::StartCheck;
use crate::config::Config;
use crate::error::TaskRefusal;
use crate::inputs::EstimateReader;
use crate::lessons::Lessons;
use crate::mailbox::{Action, Mailbox, Time};
use crate::requests::{FRESH, Kind, one_speaks};
use crate::runner::Prepared;

/// Prepares tasks of the hybrid admittance, and keeps the loop subscribed to their estimators.
pub struct Normals {
    bus: Bus,
    config: ControllerConfig,
    /// Tip of the cell's tool.
    tip: Tip,
    check: StartCheck<6>,
    lessons: Arc<Lessons>,
    estimates: Mutex<Vec<(String, Latest<NormalEstimate>)>>,
}

impl Normals {
    /// Subscribes to the estimators of the cell's configuration.
    pub fn new(bus: &Bus, config: &Config, lessons: &Arc<Lessons>) -> Result<Self, BusError> {
        let estimates = config
            .estimators
            .iter()
            .map(|name| Ok((name.clone(), bus.latest(&topics::estimate_normal(name))?)))
            .collect::<Result<_, BusError>>()?;
        Ok(Self {
            bus: bus.clone(),
            config: config.control,
            tip: config.scene.mounted.tip,
            lessons: Arc::clone(lessons),
            check: StartCheck::new(
                bus,
                config.arm,
                config.flange_from_tool,
                config.limits,
                config.estimators.clone(),
                ControllerConfig::TRAVELS,
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
        mailbox: &Mailbox<Prepared<ControllerConfig>>,
        time: Time,
    ) -> Result<bool, TaskRefusal> {
        let known = |estimates: &[(String, _)]| estimates.iter().any(|(n, _)| n == name.as_str());
        if known(&self.estimates()) {
            return Ok(false);
        }
        let topic = topics::estimate_normal(name);
        let newest = self.bus.latest(&topic)?;
        let reader = EstimateReader::new(*name, newest);
        mailbox
            .ask(Action::Listen(Box::new(Some(reader))), time)
            .map_err(TaskRefusal::Silence)?;
        // Only after the loop reads it: if the request was withdrawn, a later call repeats it.
        let newest = self.bus.latest(&topic)?;
        let mut estimates = self.estimates();
        if !known(&estimates) {
            estimates.push((name.to_string(), newest));
        }
        Ok(true)
    }
}

impl Kind for Normals {
    type Program = Prepared<ControllerConfig>;

    fn prepare(&self, text: &str) -> Result<(String, Prepared<ControllerConfig>), TaskRefusal> {
        let mut task: Task = text.parse()?;
        task.complete(&self.tip);
        let mut program = Program::new(&task, &self.config)?;
        let task = &program.task;
        self.check.task(task, &program.path)?;
        self.check
            .estimators(&self.bus, &task.estimators, topics::estimate_normal)?;
        let name = task.name.clone();
        self.lessons.recall(&mut program)?;
        Ok((name, prepared(program)))
    }

    fn leave(&self) -> Result<Prepared<ControllerConfig>, TaskRefusal> {
        Program::new(&self.check.leave(), &self.config)
            .map(prepared)
            .map_err(TaskRefusal::Control)
    }

    fn check_estimates(
        &self,
        prepared: &Prepared<ControllerConfig>,
        mailbox: &Mailbox<Prepared<ControllerConfig>>,
        time: Time,
    ) -> Result<(), TaskRefusal> {
        let Some(program) = &prepared.program else {
            return Ok(());
        };
        let fresh = |(name, newest): &mut (String, Latest<NormalEstimate>)| {
            program.estimators.iter().any(|n| n.as_str() == name) && newest.fresh(FRESH).is_some()
        };
        let speaks = self.estimates().iter_mut().any(fresh) || {
            let topics = program.estimators.iter();
            one_speaks(&self.bus, topics.map(|name| topics::estimate_normal(name)))?
        };
        if !speaks {
            return Err(TaskRefusal::NoNormal(program.task.estimators.clone()));
        }
        for name in &program.estimators {
            self.listen(name, mailbox, time)?;
        }
        Ok(())
    }

    /// Subscribes this service and the loop to the estimator's topic, and waits for its first
    /// estimate.
    fn subscribe(
        &self,
        name: &EstimatorName,
        mailbox: &Mailbox<Prepared<ControllerConfig>>,
        time: Time,
    ) -> Result<(), TaskRefusal> {
        if self.listen(name, mailbox, time)? {
            // An estimator without a publisher is no error here: the loop reports it.
            one_speaks(&self.bus, std::iter::once(topics::estimate_normal(name)))?;
        }
        Ok(())
    }
}

/// A program without readers: the loop keeps its own.
fn prepared(program: Program) -> Prepared<ControllerConfig> {
    Prepared {
        program: Some(program),
        readers: None,
    }
}
