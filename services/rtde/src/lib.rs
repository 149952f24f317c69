//! Universal Robots bridge over RTDE: state out, guarded joint velocity in.
//!
//! [`run`] keeps a connection to the controller for ever: it sets RTDE up, sends its own program to
//! the robot, and then answers each robot packet in the same cycle with what `arm/command` holds,
//! once that has passed the gate ([`tangent_actuation`]). The parts below it are pure: [`codec`] is
//! the protocol (both sides), [`bridge`] the state machine, [`program`] the robot's program and its
//! registers.

pub mod bridge;
#[cfg(test)]
mod bridge_tests;
pub mod codec;
mod cycle;
pub mod dashboard;
pub mod inquiry;
pub mod link;
mod modes;
pub mod primary;
pub mod program;
mod robot_setup;
pub mod sample;
#[cfg(test)]
mod scripted_robot;
#[cfg(test)]
mod service_tests;
pub mod settings;
mod shared;
pub mod status;
pub mod supervisor;

use std::hash::{BuildHasher, Hasher};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tangent_runtime::realtime::{RealtimeReport, setup_thread_on};
use tangent_runtime::{Bus, BusError, HealthReporter, Stop};
use tangent_schemas::topics;

use bridge::Bridge;
use cycle::{COMMANDS_MAX, Cycle};
use robot_setup::RobotSetup;
use shared::{Note, Shared};

pub use settings::{Config, SettingsError};

/// Keys of what can be asked of this service; none takes an argument.
pub mod queries {
    /// Send the program again, also in another's place; leave a latched stop.
    pub const RESET: &str = "rtde/reset";
    /// Decelerate and latch.
    pub const STOP: &str = "rtde/stop";
    /// Leave a protective stop (not in its first 5 s).
    pub const UNLOCK: &str = "rtde/unlock";
    /// Power on and release the brakes.
    pub const POWER_ON: &str = "rtde/power_on";
    /// Power off; the brakes close.
    pub const POWER_OFF: &str = "rtde/power_off";
    /// What the robot says of itself.
    pub const STATUS: &str = "rtde/status";
}

/// Why the service cannot run at all. A robot that cannot be reached is no reason: it is tried for
/// ever.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A topic or query could not be declared.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A thread could not be started.
    #[error("starting a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// A defect.
    #[error("the loop's thread panicked")]
    Panicked,
}

/// The service: until `stop`, then ramps to rest, ends the robot's program and pauses the stream.
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
    let commands = bus.subscribe(&topics::ARM_COMMAND, COMMANDS_MAX)?;
    let _answers = modes::answers(&config, &bus, &shared)?;
    let cycle = Cycle::new(
        Arc::clone(&config),
        Bridge::new(config.bridge.clone()),
        publisher,
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
                health.realtime(&realtime(&config));
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
            write_notes(&shared);
        }
        // A panic must not leave the set-up waiting.
        shared.ended.store(true, Ordering::Release);
        shared.wake_setup();
        write_notes(&shared);
        running.join().map_err(|_| Error::Panicked)
    })
}

fn realtime(config: &Config) -> RealtimeReport {
    let wish = &config.realtime;
    if wish.enabled {
        setup_thread_on("rtde loop", wish.loop_priority, wish.loop_cpu)
    } else {
        RealtimeReport::not_asked("rtde loop")
    }
}

fn write_notes(shared: &Shared) {
    while let Some(note) = shared.notes.pop() {
        match note {
            Note::Robot(text) => tracing::info!("robot ({}): {}", text.source, text.message),
            Note::Info(text) => tracing::info!("{text}"),
            Note::Warning(text) => tracing::warn!("not ready: {text}"),
            Note::Refused(text) => tracing::warn!("{text}"),
        }
    }
}
