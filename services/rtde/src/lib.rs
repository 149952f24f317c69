//! Universal Robots bridge over RTDE: state out, guarded joint velocity in.
//!
//! [`run`] keeps a connection to the controller without limit: it sets RTDE up, sends its own
//! program to the robot, and then answers each robot packet in the same cycle with the command on
//! `arm/command`, once that has passed the gate ([`tangent_actuation`]). These modules are pure:
//! [`codec`] is the protocol (both sides), [`bridge`] the state machine, [`program`] the robot's
//! program and its registers.
//!
//! ```no_run
//! use tangent_rtde::{Config, run};
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
pub mod codec;
mod cycle;
pub mod dashboard;
mod guide_mailbox;
mod guide_requests;
pub mod guiding;
pub mod inquiry;
pub mod link;
pub mod link_error;
mod modes;
pub mod own_sensor;
pub mod primary;
pub mod program;
pub mod reason;
mod robot_setup;
pub mod sample;
#[cfg(test)]
mod scripted_robot;
mod sequence;
#[cfg(test)]
mod service_tests;
pub mod settings;
mod shared;
mod shutdown;
pub mod status;
pub mod supervisor;

use std::hash::{BuildHasher, Hasher};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tangent_runtime::arm_commands::COMMANDS_MAX;
use tangent_runtime::{Bus, BusError, HealthReporter, Stop};
use tangent_schemas::topics;

use bridge::Bridge;
use cycle::{Cycle, Outlets};
use robot_setup::RobotSetup;
use shared::Shared;

pub use settings::{Config, SettingsError};

/// Keys of the requests to this service; only `GUIDE` takes an argument.
pub mod queries {
    /// Send the program again, even in place of another one, and leave a latched stop.
    pub const RESET: &str = "rtde/reset";
    /// Decelerate and latch.
    pub const STOP: &str = "rtde/stop";
    /// Leave a protective stop (not in its first 5 s).
    pub const UNLOCK: &str = "rtde/unlock";
    /// Power on and release the brakes.
    pub const POWER_ON: &str = "rtde/power_on";
    /// Power off; the brakes close.
    pub const POWER_OFF: &str = "rtde/power_off";
    /// Let a hand guide the arm: `begin`, `keep` and `end`, each with the name of the client that
    /// guides as the argument.
    pub const GUIDE: &str = "rtde/guide";
    /// Report the state of the robot.
    pub const STATUS: &str = "rtde/status";
}

/// Errors that prevent the service from running. A robot that cannot be reached is not among them:
/// connecting is retried without limit.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A topic or query could not be declared.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A thread could not be started.
    #[error("starting a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// A thread panicked, which is a defect.
    #[error("the loop's thread panicked")]
    Panicked,
}

/// Runs the service until `stop`, then ramps to rest, ends the robot's program and pauses the
/// stream.
///
/// # Errors
/// [`Error`]: only what prevents it from starting.
pub fn run(mut config: Config, bus: Bus, stop: Stop) -> Result<(), Error> {
    // Fresh at each start, so that registers left by an earlier run never match.
    config.bridge.seed = std::hash::RandomState::new().build_hasher().finish();
    let config = Arc::new(config);
    let shared = Arc::new(Shared::new());
    let health = Arc::new(HealthReporter::start_only(&bus, "rtde")?);
    let publisher = bus.publisher(&topics::ARM_STATE)?;
    let wrench = match config.bridge.wrench {
        Some(_) => Some(bus.publisher(&topics::ARM_WRENCH)?),
        None => None,
    };
    let commands = bus.subscribe(&topics::ARM_COMMAND, COMMANDS_MAX)?;
    let _answers = modes::answers(&config, &bus, &shared)?;
    let _guide = guide_requests::answers(&bus, &shared)?;
    let cycle = Cycle::new(
        Arc::clone(&config),
        Bridge::new(config.bridge.clone()),
        Outlets {
            state: publisher,
            wrench,
        },
        commands,
        Arc::clone(&shared),
        Arc::clone(&health),
        stop.clone(),
    );
    std::thread::scope(|scope| {
        let setup = std::thread::Builder::new()
            .name("rtde-setup".into())
            .spawn_scoped(scope, || RobotSetup::new(&config, &shared, &stop).run())?;
        // Set once; a second service in this process has its own `shared`.
        let _ = shared.setup.set(setup.thread().clone());
        let spawned = std::thread::Builder::new()
            .name("rtde-loop".into())
            .spawn_scoped(scope, || {
                health.realtime(&config.realtime.setup_loop("rtde loop"));
                cycle.run();
            });
        let running = match spawned {
            Ok(running) => running,
            Err(error) => {
                shared.ended.store(true, Ordering::Release);
                return Err(error.into());
            }
        };
        while !running.is_finished() {
            std::thread::park_timeout(Duration::from_millis(50));
            shared.notes.write();
        }
        // A panic must not leave the set-up waiting.
        shared.ended.store(true, Ordering::Release);
        shared.wake_setup();
        shared.notes.write();
        running.join().map_err(|_| Error::Panicked)
    })
}
