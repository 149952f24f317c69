//! The simulated Franka as a service: the robot, its true state on the bus, and faults on request.

use std::time::Duration;

use tangent_runtime::{Bus, BusError, HealthReporter, Stop};
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::TRUTH_CONTACT;

use super::bench::BenchPlant;
use super::config::FciConfig;
use super::fault::FciFault;
use super::plant::TorquePlant;
use super::server::{FciStartError, SimulatedFranka};
use crate::service::truth_message;

/// Key of requests that provoke faults: the action is the fault's name, the argument its value.
pub const FAULT_KEY: &str = crate::service::FAULT_KEY;

/// Why the service ended.
#[derive(Debug, thiserror::Error)]
pub enum FciServiceError {
    /// The robot could not start.
    #[error("simulator: {0}")]
    Start(#[from] FciStartError),
    /// The bus refused a topic or key.
    #[error("simulator: {0}")]
    Bus(#[from] BusError),
    /// The thread of the robot has ended.
    #[error("simulator: the simulated robot stopped by itself; the log says why")]
    Ended,
}

/// Runs the simulated robot in front of a plane until it is stopped.
///
/// # Errors
/// A port is taken, or the bus refuses a topic or key.
pub fn run(config: FciConfig, bus: Bus, stop: Stop) -> Result<(), FciServiceError> {
    let plant = BenchPlant::new(&config.plant).map_err(FciStartError::from)?;
    run_with(&config, Box::new(plant), &bus, &stop)
}

/// Runs the simulated robot with any plant until it is stopped.
///
/// # Errors
/// A port is taken, or the bus refuses a topic or key.
pub fn run_with(
    config: &FciConfig,
    plant: Box<dyn TorquePlant>,
    bus: &Bus,
    stop: &Stop,
) -> Result<(), FciServiceError> {
    let health = HealthReporter::start_only(bus, "simulator")?;
    let cycles = health.rate("cycles");
    let publisher = bus.publisher(&TRUTH_CONTACT)?;
    let robot = SimulatedFranka::start_with(
        config,
        plant,
        Some(Box::new(move |truth| {
            publisher.publish(&truth_message(truth));
        })),
    )?;
    let faults = robot.faults();
    let _answering = bus.answer(FAULT_KEY, move |_, request: Request| match FciFault::parse(
        &request.action,
        &request.argument,
    ) {
        Ok(fault) => {
            faults(fault);
            Answer {
                done: true,
                message: format!("{fault:?}"),
                ..Answer::default()
            }
        }
        Err(error) => Answer {
            message: error.to_string(),
            ..Answer::default()
        },
    })?;
    tracing::info!(target: "simulator", "Franka at {}", robot.address());
    health.running();
    let missed = health.missed_cycles();
    let mut cycles_before = 0;
    while !stop.wait(Duration::from_millis(200)) {
        if let Some(snapshot) = robot.snapshot() {
            missed.set(snapshot.missed);
            for _ in cycles_before..snapshot.cycles {
                cycles.tick();
            }
            cycles_before = snapshot.cycles;
        }
        if robot.has_ended() {
            return Err(FciServiceError::Ended);
        }
    }
    Ok(())
}
