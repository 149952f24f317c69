//! The controller for arms that take torques: one step of the law per packet of the arm, at 1 kHz in one process with it.
//!
//! It is what [`crate::run`] is for arms that take velocities, with the same topics and queries; the law and what it reads
//! besides the wrench come with each task as a [`TorqueProgram`].

mod choice;
mod config;
mod cycle;
mod object_readers;
mod objects;
mod program;
mod unified;

use std::sync::Arc;

use nalgebra::Vector3;
use tangent_control::Parameter;
use tangent_runtime::{Beat, Bus, HealthReporter, Parameters, StateFolder, Stop};
use tangent_schemas::convert::cut_format;
use tangent_schemas::topics;

pub use config::TorqueConfig;

use crate::desk::{Desk, Kind};
use crate::inputs::WrenchReader;
use crate::mailbox::Mailbox;
use crate::memory::Memory;
use crate::pinned::PinnedArm;
use crate::watch::Watch;
use crate::{ControllerError, SERVICE, beside};
use cycle::{Boxed, TorqueCycle, TorqueMeters};
use objects::Objects;
use unified::Unified;

/// Runs until `stop`; a running task is then ended with a retraction. Blocks.
///
/// # Errors
/// [`ControllerError`]: only what prevents it from starting.
pub fn run_torque(config: TorqueConfig, bus: Bus, stop: Stop) -> Result<(), ControllerError> {
    match config {
        TorqueConfig::HybridDynamics(config) => {
            let state = config.state.clone();
            run_kind(Objects::new(&bus, *config)?, state, &bus, &stop)
        }
        TorqueConfig::UnifiedForceImpedance(config) => {
            let state = config.state.clone();
            run_kind(Unified::new(&bus, *config)?, state, &bus, &stop)
        }
    }
}

fn run_kind<K: Kind<Program = Boxed>>(
    kind: K,
    state: Option<StateFolder>,
    bus: &Bus,
    stop: &Stop,
) -> Result<(), ControllerError> {
    let health = Arc::new(HealthReporter::start_only(bus, SERVICE)?);
    let parameters = Parameters::new(bus, SERVICE)?;
    let mailbox = Arc::new(Mailbox::default());
    let command = bus.publisher(&topics::ARM_COMMAND)?;
    let own_id = command.mark();
    let (lower, upper) = Parameter::ForceReference.range();
    let force_reference = parameters.number(
        Parameter::ForceReference.name(),
        lower,
        lower..=upper,
        "N",
        "Pressing force of the running task.",
    );
    let memory = Arc::new(Memory::open(state));
    let desk = Desk::new(bus, &mailbox, kind, own_id, &memory)?;
    let mut cycle = TorqueCycle {
        program: None,
        activation: 0,
        latched: 0,
        arm: PinnedArm::default(),
        ready: false,
        clearance: memory.known(),
        position: Vector3::zeros(),
        wrench: WrenchReader::new(
            bus.latest(&topics::WRENCH_TOOL)?,
            bus.latest(&topics::WRENCH_STATUS)?,
        ),
        command,
        state: bus.publisher(&topics::CONTROL_STATE)?,
        shaping: bus.publisher(&topics::CONTROL_SHAPING)?,
        source: cut_format(format_args!("{SERVICE}/{}", health.instance())),
        mailbox: Arc::clone(&mailbox),
        meters: TorqueMeters::new(&health),
        watch: Watch::new(&mailbox, &health),
        force_reference_seen: force_reference.get(),
        force_reference,
        started: std::time::Instant::now(),
    };
    health.running();
    // Nobody calls it while the arm is silent; a cycle that has begun has to end.
    let beat = Beat::new(SERVICE);
    beat.rest();
    let _loop = bus.on(&topics::ARM_STATE, move |arm| {
        beat.beat();
        cycle.step(arm);
        beat.rest();
    })?;
    let _answers = desk.open()?;
    beside(bus, &mailbox, &memory, stop)
}
