//! Franka bridge over FCI: state and external wrench out, guarded joint torque in.
//!
//! [`run`] keeps a connection to the robot without limit: it sets the robot up, runs a torque
//! motion while a controller sends commands, and answers each of the robot's packets in the same
//! cycle with the command on `arm/command`, once that has passed the gate ([`tangent_actuation`]).
//! The modules below it are pure: [`fci`] is the protocol (both sides), [`session`] the sequence of
//! requests and replies, [`bridge`] the whole state machine.
//!
//! ```no_run
//! use tangent_franka::{Config, run};
//! use tangent_runtime::bus::{Bus, Role};
//! use tangent_runtime::config::CellConfig;
//! use tangent_runtime::stop::Stop;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let cell = CellConfig::load("deploy/cell.toml".as_ref())?;
//! let stop = Stop::on_signals()?;
//! let bus = Bus::open_until(&cell, Role::Client, None, &stop)?;
//! run(Config::from_cell(&cell)?, bus, stop)?;
//! # Ok(())
//! # }
//! ```

pub mod bridge;
#[cfg(test)]
mod bridge_tests;
mod cycle;
mod estimate;
pub mod fci;
#[cfg(test)]
mod fci_tests;
pub mod inquiry;
mod link;
mod meters;
mod modes;
pub mod session;
pub mod settings;
mod shared;
pub mod wrench;
mod wrench_watch;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tangent_runtime::arm_commands::COMMANDS_MAX;
use tangent_runtime::bus::answer::done;
use tangent_runtime::{Bus, BusError, Handle, HealthReporter, Lane, Stop};
use tangent_schemas::topics;
use tangent_sensing::SensingError;
use tangent_tare::TareSetup;

use cycle::{Cycle, Outlets};
use estimate::Estimate;
use shared::Shared;

pub use settings::{Config, SettingsError};

/// Name of the service in topics, health and parameters.
pub const SERVICE: &str = "franka";

/// Keys of the requests to this service; none takes an argument. It also answers `netft/tare`, for
/// its own wrench.
pub mod queries {
    /// Leave a reflex.
    pub const RECOVER: &str = "franka/recover";
    /// Report the state of the robot.
    pub const STATUS: &str = "franka/status";
    /// Leave a reflex, as `franka/recover` does; refused if there is none.
    pub const UNLOCK: &str = "franka/unlock";
    /// Leave a reflex or a latched stop.
    pub const RESET: &str = "franka/reset";
    /// Refused, with advice: brakes are opened in the robot's own web page.
    pub const POWER_ON: &str = "franka/power_on";
    /// Refused, with advice: brakes are closed in the robot's own web page.
    pub const POWER_OFF: &str = "franka/power_off";
    /// Refused, with advice: an arm of Franka is guided with the buttons at its hand.
    pub const GUIDE: &str = "franka/guide";
    /// End the motion now; a task has to be started again before the arm moves.
    pub const STOP: &str = "franka/stop";
}

/// Errors that prevent the service from running. A robot that cannot be reached is not among them:
/// connecting is retried without limit.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A topic or query could not be declared.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A setting of the tare is out of range.
    #[error("[robot.franka]: {0}")]
    Tare(#[from] SensingError),
    /// A thread could not be started.
    #[error("starting a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// A thread panicked, which is a defect.
    #[error("the loop's thread panicked")]
    Panicked,
}

/// Runs the service until `stop`, then holds the arm and ends the motion.
///
/// # Errors
/// [`Error`]: only what prevents it from starting.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), Error> {
    let config = Arc::new(config);
    let shared = Arc::new(Shared::default());
    let health = Arc::new(HealthReporter::start_only(&bus, SERVICE)?);
    let outlets = Outlets {
        state: bus.publisher(&topics::ARM_STATE)?,
        wrench: bus.publisher(&topics::WRENCH_TOOL)?,
        wrench_status: bus.publisher(&topics::WRENCH_STATUS)?,
    };
    let commands = bus.subscribe(&topics::ARM_COMMAND, COMMANDS_MAX)?;
    let _answers = answers(&bus, &shared)?;
    let setup = TareSetup {
        service: SERVICE,
        state: config.state.clone(),
        duration_s: config.tare.duration_s,
        silence: "the robot sends no states to take the zero from",
    };
    let (taring, _keeper) = tangent_tare::open(&bus, &setup)?.start()?;
    let estimate = Estimate::new(&config.tare, taring, &zero_of(&config))?;
    let _modes = modes::answers(&bus)?;
    let cycle = Cycle::new(
        Arc::clone(&config),
        outlets,
        commands,
        estimate,
        Arc::clone(&shared),
        Arc::clone(&health),
        stop,
    );
    std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("franka-loop".into())
            .spawn_scoped(scope, || {
                health.realtime(&config.realtime.setup_loop("franka loop"));
                cycle.run();
            })?;
        while !running.is_finished() {
            std::thread::park_timeout(Duration::from_millis(50));
            shared.notes.write();
        }
        shared.notes.write();
        running.join().map_err(|_| Error::Panicked)
    })
}

/// Owner of a zero, as the robot and its tool: FCI gives no serial number, and the zero applies at
/// the tool.
fn zero_of(config: &Config) -> String {
    let tool = config.flange_from_tool;
    let (at, turn) = (tool.translation(), tool.rotation().scaled_axis());
    format!(
        "{}:{}, tool at {:.4} {:.4} {:.4} m, {:.3} {:.3} {:.3} rad",
        config.host, config.port, at.x, at.y, at.z, turn.x, turn.y, turn.z
    )
}

fn answers(bus: &Bus, shared: &Arc<Shared>) -> Result<Vec<Handle>, BusError> {
    let [recovering, stopping] = [(); 2].map(|()| Arc::clone(shared));
    Ok(vec![
        bus.answer(queries::RECOVER, move |_, _| {
            recovering.recover_asked.store(true, Ordering::Release);
            done(
                "the robot leaves its reflex, if it is in one; arm/state reports when the arm is ready",
            )
        })?,
        bus.answer_in(
            queries::STOP,
            |_| Lane::Urgent,
            move |_| {
                stopping.stop_asked.store(true, Ordering::Release);
                done("the motion is ended; start a task to move again").into()
            },
        )?,
    ])
}
