//! Prepares tasks of `hybrid_dynamics` for the loop, with the object-pose estimators that they
//! name.

use arrayvec::ArrayVec;
use tangent_control::{HybridDynamicsConfig, Program, Task};
use tangent_runtime::{Bus, BusError};
use tangent_schemas::topics;

use super::start_check::StartCheck;
use crate::config::torque::ObjectsConfig;
use crate::error::TaskRefusal;
use crate::inputs::{ObjectReader, Readers};
use crate::mailbox::{Mailbox, Time};
use crate::requests::{Kind, one_speaks};
use crate::runner::Prepared;

/// Prepares tasks outside the loop.
pub struct Objects {
    bus: Bus,
    config: ObjectsConfig,
    check: StartCheck<6>,
}

impl Objects {
    /// Prepares tasks for the cell's arm and object.
    ///
    /// # Errors
    /// `arm/state` cannot be read.
    pub fn new(bus: &Bus, config: ObjectsConfig) -> Result<Self, BusError> {
        Ok(Self {
            check: StartCheck::new(
                bus,
                config.arm,
                config.flange_from_tool,
                config.limits,
                config.estimators.clone(),
            )?,
            bus: bus.clone(),
            config,
        })
    }

    fn program(&self, task: &Task) -> Result<Program<HybridDynamicsConfig>, TaskRefusal> {
        let law = self.config.law(task.controller.as_deref())?;
        Ok(Program::with_config(task, law)?)
    }

    /// The program with its readers. Nothing is checked that depends on the arm's present position.
    fn prepared(
        &self,
        program: Program<HybridDynamicsConfig>,
    ) -> Result<Prepared<HybridDynamicsConfig>, TaskRefusal> {
        let mut objects = ArrayVec::new();
        for name in &program.estimators {
            let newest = self.bus.latest(&topics::estimate_object(name));
            objects.push(ObjectReader::new(*name, newest?));
        }
        let readers = Readers {
            objects,
            ..Readers::default()
        };
        Ok(Prepared {
            program: Some(program),
            readers: Some(readers),
        })
    }
}

impl Kind for Objects {
    type Program = Prepared<HybridDynamicsConfig>;

    fn prepare(&self, text: &str) -> Result<(String, Self::Program), TaskRefusal> {
        let task: Task = text.parse()?;
        let program = self.program(&task)?;
        self.check.task(&task, &program.path)?;
        self.check
            .estimators(&self.bus, &task.estimators, topics::estimate_object)?;
        Ok((task.name, self.prepared(program)?))
    }

    fn leave(&self) -> Result<Self::Program, TaskRefusal> {
        self.prepared(self.program(&self.check.leave())?)
    }

    fn check_estimates(
        &self,
        prepared: &Self::Program,
        _: &Mailbox<Self::Program>,
        _: Time,
    ) -> Result<(), TaskRefusal> {
        let Some(program) = &prepared.program else {
            return Ok(());
        };
        let names = &program.task.estimators;
        let topics = names.iter().map(|name| topics::estimate_object(name));
        if one_speaks(&self.bus, topics)? {
            return Ok(());
        }
        Err(TaskRefusal::NoObject(names.clone()))
    }
}
