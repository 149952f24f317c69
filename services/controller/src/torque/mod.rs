//! The controller for arms that take torques: one step of the law per packet of the arm, at 1 kHz
//! in one process with it.
//!
//! It is what [`crate::run`] is for arms that take velocities, with the same topics and queries;
//! the law and what it reads besides the wrench come with each task as a [`TorqueProgram`].

mod choice;
mod config;
mod object_readers;
mod objects;
mod program;
mod runner;
mod unified;

use std::sync::Arc;

use tangent_control::{Limits, Parameter};
use tangent_runtime::{Bus, HealthReporter, Parameters, StateFolder, Stop};
use tangent_schemas::convert::cut_format;
use tangent_schemas::topics;

pub use config::TorqueConfig;

use crate::cycle::{Cycle, Outlets};
use crate::inputs::WrenchReader;
use crate::mailbox::Mailbox;
use crate::memory::Memory;
use crate::requests::{Kind, RequestHandler};
use crate::{ControllerError, SERVICE, serve};
use objects::Objects;
use runner::{Boxed, TorqueRunner};
use unified::Unified;

/// Runs until `stop`; a running task is then ended with a retraction. Blocks.
///
/// # Errors
/// [`ControllerError`]: only what prevents it from starting.
pub fn run_torque(config: TorqueConfig, bus: Bus, stop: Stop) -> Result<(), ControllerError> {
    match config {
        TorqueConfig::HybridDynamics(config) => {
            let (state, limits) = (config.state.clone(), config.limits);
            run_kind(Objects::new(&bus, *config)?, state, &limits, &bus, &stop)
        }
        TorqueConfig::UnifiedForceImpedance(config) => {
            let (state, limits) = (config.state.clone(), config.limits);
            run_kind(Unified::new(&bus, *config)?, state, &limits, &bus, &stop)
        }
    }
}

fn run_kind<K: Kind<Program = Boxed>>(
    kind: K,
    state: Option<StateFolder>,
    limits: &Limits,
    bus: &Bus,
    stop: &Stop,
) -> Result<(), ControllerError> {
    let health = Arc::new(HealthReporter::start_only(bus, SERVICE)?);
    let parameters = Parameters::new(bus, SERVICE)?;
    let mailbox = Arc::new(Mailbox::default());
    let command = bus.publisher(&topics::ARM_COMMAND)?;
    let own_id = command.mark();
    let (lower, upper) = Parameter::ForceReference.range_within(limits);
    let force_reference = parameters.number(
        Parameter::ForceReference.name(),
        lower,
        lower..=upper,
        "N",
        "Pressing force of the running task.",
    );
    let memory = Arc::new(Memory::open(state));
    let handler = RequestHandler::new(bus, &mailbox, kind, own_id, &memory)?;
    let wrench = WrenchReader::new(
        bus.latest(&topics::WRENCH_TOOL)?,
        bus.latest(&topics::WRENCH_STATUS)?,
    );
    let runner = TorqueRunner::new(wrench, memory.known(), force_reference);
    let outlets = Outlets {
        command,
        state: bus.publisher(&topics::CONTROL_STATE)?,
        shaping: Some(bus.publisher(&topics::CONTROL_SHAPING)?),
        source: cut_format(format_args!("{SERVICE}/{}", health.instance())),
    };
    let cycle = Cycle::new(runner, outlets, &mailbox, &health);
    serve(bus, cycle, handler, &mailbox, &memory, &health, stop)
}
