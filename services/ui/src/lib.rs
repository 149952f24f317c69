//! The operator's page: shows a cell in a browser, and passes people's commands on to it.
//!
//! It listens to `arm/state`, `control/state`, `base/pose`, the estimates and the healths, adds up
//! the dose of pressure on the surface, and forms a snapshot 20 times a second. Every page reads
//! the newest one over HTTP. Commands of people with a token are sent to the cell as requests, and
//! published on `operator/command`, so that the recording has them. `tangent ui` and
//! `tangent run ui` start it, in a process without the control loop.

pub mod access;
mod commands;
mod config;
mod connection;
mod error;
mod export;
mod lights;
mod page;
mod pages;
mod recordings;
mod server;
mod shared;
mod snapshot;
mod task_band;
mod tasks;
mod teach;
mod teacher;
mod tools;
mod watcher;

use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tangent_runtime::{Beat, Bus, HealthReporter, Stop};
use tangent_scene::cover_radius_m;
use tangent_schemas::topics;

use commands::Desk;
pub use config::Config;
pub use error::UiError;
use shared::Shared;
use tangent_scene::dose::DoseMap;
pub use tasks::SaveError;
pub use teacher::{TaskWish, TaughtMark, TaughtShape, TaughtTask, TeachState, TeachStep, Teacher};
pub use tools::{Calibration, CalibrationStep, Calibrator, Reporter, Tools};
use watcher::Watcher;

/// Name of the service in topics and health messages.
pub const SERVICE: &str = "ui";
/// Services that must not run in the process of the page: they are the control loop.
pub const NOT_BESIDE: [&str; 4] = ["rtde", "franka", "netft", "controller"];
/// Longest wait for the threads that serve the pages to end.
const END: Duration = Duration::from_secs(1);
/// Longest time of one turn, on a machine under heavy load: it waits for no page.
const TURN_MAX: Duration = Duration::from_secs(10);

/// Serves pages until `stop`. `listening` is told the address once. `tools` are what the program
/// that calls it does for the page.
///
/// # Errors
/// The address is in use, or the bus refuses a topic.
pub fn run(
    config: Config,
    bus: &Bus,
    stop: &Stop,
    tools: Tools,
    listening: impl FnOnce(SocketAddr),
) -> Result<(), UiError> {
    let health = HealthReporter::start(bus, SERVICE)?;
    let address = config.address;
    let listen = |source| UiError::Listen { address, source };
    let listener = std::net::TcpListener::bind(address).map_err(listen)?;
    listener.set_nonblocking(true).map_err(listen)?;
    let bound = listener.local_addr().map_err(listen)?;
    let threads = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .max_blocking_threads(shared::WAITING_THREADS)
        .thread_name("ui-page")
        .enable_all()
        .build()?;
    let listener = {
        let _inside = threads.enter();
        tokio::net::TcpListener::from_std(listener).map_err(listen)?
    };
    let record = bus.publisher(&topics::OPERATOR_COMMAND)?;
    let desk = Desk::new(bus, record, config.tasks.clone());
    let dose = DoseMap::new(cover_radius_m(&config.scene.mounted.tip));
    let shared = Arc::new(Shared::new(config, desk, dose, tools));
    let mut watcher = Watcher::new(bus, &shared, &health)?;
    let serving = threads.spawn(server::serve(listener, Arc::clone(&shared)));
    tracing::info!("page: http://{bound}");
    listening(bound);
    health.running();
    let beat = Beat::new(SERVICE);
    while !stop.is_stopped() && !serving.is_finished() {
        beat.within(TURN_MAX);
        watcher.turn();
    }
    drop(beat);
    serving.abort();
    threads.shutdown_timeout(END);
    Ok(())
}

/// Takes a lock, also after a panic of another holder: what is locked is whole at any time.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
