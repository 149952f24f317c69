//! Prepares tasks of `unified_force_impedance` for the loop, with the normal estimators that they
//! name.

use arrayvec::ArrayVec;
use tangent_control::{Program, Task, UnifiedForceImpedanceConfig};
use tangent_runtime::{Bus, BusError};
use tangent_schemas::topics;

use super::start_check::StartCheck;
use crate::config::torque::UnifiedConfig;
use crate::error::TaskRefusal;
use crate::inputs::{EstimateReader, Readers, VisionReader};
use crate::mailbox::{Mailbox, Time};
use crate::requests::{Kind, one_speaks};
use crate::runner::Prepared;

/// Prepares tasks outside the loop.
pub struct Unified {
    bus: Bus,
    config: UnifiedConfig,
    check: StartCheck<7>,
}

impl Unified {
    /// Prepares tasks for the cell's arm.
    ///
    /// # Errors
    /// `arm/state` cannot be read.
    pub fn new(bus: &Bus, config: UnifiedConfig) -> Result<Self, BusError> {
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

    fn program(&self, task: &Task) -> Result<Program<UnifiedForceImpedanceConfig>, TaskRefusal> {
        let law = self.config.law(task.controller.as_deref())?;
        Ok(Program::with_config(task, law)?)
    }

    /// The program with its readers. Nothing is checked that depends on the arm's present position.
    fn prepared(
        &self,
        program: Program<UnifiedForceImpedanceConfig>,
    ) -> Result<Prepared<UnifiedForceImpedanceConfig>, TaskRefusal> {
        let mut normals = ArrayVec::new();
        for name in &program.estimators {
            let newest = self.bus.latest(&topics::estimate_normal(name));
            normals.push(EstimateReader::new(*name, newest?));
        }
        let readers = Readers {
            normals,
            vision: Some(VisionReader::new(&self.bus)?),
            ..Readers::default()
        };
        Ok(Prepared {
            program: Some(program),
            readers: Some(readers),
        })
    }
}

impl Kind for Unified {
    type Program = Prepared<UnifiedForceImpedanceConfig>;

    fn prepare(&self, text: &str) -> Result<(String, Self::Program), TaskRefusal> {
        let task: Task = text.parse()?;
        let program = self.program(&task)?;
        self.check.task(&task, &program.path)?;
        self.check
            .estimators(&self.bus, &task.estimators, topics::estimate_normal)?;
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
        let topics = names.iter().map(|name| topics::estimate_normal(name));
        if one_speaks(&self.bus, topics)? {
            return Ok(());
        }
        Err(TaskRefusal::NoNormal(names.clone()))
    }
}
