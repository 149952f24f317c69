//! Prepares tasks of a torque law for the loop, with the estimators that they name.
//!
//! What differs between the laws is a [`ServedLaw`].

use tangent_control::{Clearance, ControlError, EstimatorNames, Law, Program, Task};
use tangent_runtime::{Bus, BusError};
use tangent_schemas::Message;
use tangent_schemas::topics::Topic;

use super::start_check::StartCheck;
use crate::config::torque::{CellLaw, TorqueCell};
use crate::error::TaskRefusal;
use crate::inputs::Readers;
use crate::mailbox::{Mailbox, Time};
use crate::requests::{Kind, one_speaks};
use crate::runner::Prepared;

/// A torque law in the service: how it is made, and its estimators on the bus.
pub trait ServedLaw: CellLaw {
    /// The law for an arm of `N` joints.
    type Law<const N: usize>: Law<N, Config = Self> + 'static;

    /// Message of the estimators that a task names.
    type Estimate: Message;

    /// The law before the first task; `clearance` is what is known of the tool.
    ///
    /// # Errors
    /// A parameter or limit is out of its range.
    fn law<const N: usize>(
        cell: &TorqueCell<Self, N>,
        clearance: Clearance,
    ) -> Result<Self::Law<N>, ControlError>;

    /// Topic of an estimator.
    fn topic(estimator: &str) -> Topic<Self::Estimate>;

    /// Readers of a task's estimators.
    ///
    /// # Errors
    /// A topic cannot be read.
    fn readers(bus: &Bus, estimators: &EstimatorNames) -> Result<Readers, BusError>;

    /// Refusal of a task of which no estimator publishes.
    fn silent(estimators: Vec<String>) -> TaskRefusal;
}

/// Prepares tasks outside the loop.
pub struct TorqueTasks<C: ServedLaw, const N: usize> {
    bus: Bus,
    cell: TorqueCell<C, N>,
    check: StartCheck<N>,
}

impl<C: ServedLaw, const N: usize> TorqueTasks<C, N> {
    /// Prepares tasks for the cell.
    ///
    /// # Errors
    /// `arm/state` cannot be read.
    pub fn new(bus: &Bus, cell: TorqueCell<C, N>) -> Result<Self, BusError> {
        Ok(Self {
            check: StartCheck::new(
                bus,
                cell.arm,
                cell.flange_from_tool,
                cell.limits,
                cell.estimators.clone(),
                C::TRAVELS,
            )?,
            bus: bus.clone(),
            cell,
        })
    }

    fn program(&self, task: &Task) -> Result<Program<C>, TaskRefusal> {
        let law = self.cell.parameters(task.controller.as_deref())?;
        Ok(Program::with_config(task, law)?)
    }

    /// The program with its readers. Nothing is checked that depends on the arm's present position.
    fn prepared(&self, program: Program<C>) -> Result<Prepared<C>, TaskRefusal> {
        let readers = C::readers(&self.bus, &program.estimators)?;
        Ok(Prepared {
            program: Some(program),
            readers: Some(readers),
        })
    }
}

impl<C: ServedLaw, const N: usize> Kind for TorqueTasks<C, N> {
    type Program = Prepared<C>;

    fn prepare(&self, text: &str) -> Result<(String, Self::Program), TaskRefusal> {
        let task: Task = text.parse()?;
        let program = self.program(&task)?;
        self.check.task(&task, &program.path)?;
        self.check
            .estimators(&self.bus, &task.estimators, C::topic)?;
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
        if one_speaks(&self.bus, names.iter().map(|name| C::topic(name)))? {
            return Ok(());
        }
        Err(C::silent(names.clone()))
    }
}
