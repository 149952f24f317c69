//! Franka bridge over FCI: state and external wrench out, guarded joint torque in.
//!
//! [`run`] keeps a connection to the robot for ever: it sets the robot up, runs a torque motion while somebody commands, and
//! answers each of the robot's packets in the same cycle with what `arm/command` holds, once that has passed the [`guard`].
//! The parts below it are pure: [`fci`] is the protocol (both sides), [`session`] the conversation, [`bridge`] the whole
//! state machine.

pub mod bridge;
#[cfg(test)]
mod bridge_tests;
mod cycle;
pub mod fci;
#[cfg(test)]
mod fci_tests;
pub mod guard;
#[cfg(test)]
mod guard_tests;
pub mod inquiry;
mod link;
mod meters;
mod refusal;
pub mod session;
pub mod settings;
mod shared;
pub mod tare;
pub mod wrench;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::realtime::{RealtimeReport, setup_thread_on};
use tangent_runtime::{Bus, BusError, Handle, HealthReporter, Stop};
use tangent_schemas::tangent::Answer;
use tangent_schemas::topics;

use cycle::{COMMANDS_MAX, Cycle, Outlets};
use shared::{LoopRequest, Note, Shared};

pub use settings::{Config, SettingsError};

/// Name of the service in topics, health and parameters.
pub const SERVICE: &str = "franka";

/// A tare takes a quarter of a second of states; longer, and there are none.
const TARE_PATIENCE: Duration = Duration::from_secs(1);

/// Keys of what can be asked of this service; none takes an argument. It answers `netft/tare` too, for its own wrench.
pub mod queries {
    /// Leave a reflex.
    pub const RECOVER: &str = "franka/recover";
    /// End the motion now; moving needs a task started anew.
    pub const STOP: &str = "franka/stop";
}

/// Why the service cannot run at all. A robot that cannot be reached is no reason: it is tried for ever.
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

/// The service: until `stop`, then holds the arm and ends the motion.
///
/// # Errors
/// [`Error`]: only what prevents it from starting.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), Error> {
    let config = Arc::new(config);
    let shared = Arc::new(Shared::new());
    let health = Arc::new(HealthReporter::start_only(&bus, SERVICE)?);
    let outlets = Outlets {
        state: bus.publisher(&topics::ARM_STATE)?,
        wrench: bus.publisher(&topics::WRENCH_TOOL)?,
        wrench_status: bus.publisher(&topics::WRENCH_STATUS)?,
    };
    let commands = bus.subscribe(&topics::ARM_COMMAND, COMMANDS_MAX)?;
    let _answers = answers(&bus, &shared)?;
    let cycle = Cycle::new(
        Arc::clone(&config),
        outlets,
        commands,
        Arc::clone(&shared),
        Arc::clone(&health),
        stop,
    );
    std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("franka-loop".into())
            .spawn_scoped(scope, || {
                health.realtime(&realtime(&config));
                cycle.run();
            })?;
        while !running.is_finished() {
            std::thread::park_timeout(Duration::from_millis(50));
            write_notes(&shared);
        }
        write_notes(&shared);
        running.join().map_err(|_| Error::Panicked)
    })
}

fn realtime(config: &Config) -> RealtimeReport {
    let wish = &config.realtime;
    if wish.enabled {
        setup_thread_on("franka loop", wish.loop_priority, wish.loop_cpu)
    } else {
        RealtimeReport::not_asked("franka loop")
    }
}

fn write_notes(shared: &Shared) {
    while let Some(note) = shared.notes.pop() {
        match note {
            Note::Info(text) => tracing::info!("{text}"),
            Note::Warning(text) => tracing::warn!("not ready: {text}"),
            Note::Refused(text) => tracing::warn!("{text}"),
        }
    }
}

fn answers(bus: &Bus, shared: &Arc<Shared>) -> Result<Vec<Handle>, BusError> {
    let ask_loop = |request: LoopRequest, words: &'static str| {
        let shared = Arc::clone(shared);
        move || {
            shared.requests.force_push(request);
            done(words)
        }
    };
    let recover = ask_loop(
        LoopRequest::Recover,
        "the robot leaves its reflex, if it is in one; arm/state says when the arm is ready",
    );
    let stop = ask_loop(
        LoopRequest::Stop,
        "the motion is ended; start a task to move again",
    );
    let taring = Arc::clone(shared);
    Ok(vec![
        bus.answer(queries::RECOVER, move |_, _| recover())?,
        bus.answer(queries::STOP, move |_, _| stop())?,
        bus.answer(topics::queries::NETFT_TARE, move |_, _| tare(&taring))?,
    ])
}

fn tare(shared: &Shared) -> Answer {
    let before = shared.tares.load(Ordering::Acquire);
    shared.requests.force_push(LoopRequest::Tare);
    let deadline = Instant::now() + TARE_PATIENCE;
    while Instant::now() < deadline {
        if shared.tares.load(Ordering::Acquire) != before {
            return done("the robot's present estimate of the wrench is its zero");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    refused("the robot sends no states to take the zero from")
}
