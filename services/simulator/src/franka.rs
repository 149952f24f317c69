//! The simulated Franka as a service: the ground truth of its contact on the bus, and faults on
//! request.

use std::time::Duration;

use tangent_runtime::{Bus, BusError, HealthReporter, Stop};
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::TRUTH_CONTACT;
use tangent_simulated_device::{FAULT_KEY, fault_answer, truth_message};
use tangent_simulated_franka::{
    BenchPlant, FciConfig, FciFault, FciStartError, SimulatedFranka, TorquePlant,
};

/// Why the service ended.
#[derive(Debug, thiserror::Error)]
pub enum FrankaError {
    /// The robot could not start.
    #[error("simulator: {0}")]
    Start(#[from] FciStartError),
    /// The bus refused a topic or key.
    #[error("simulator: {0}")]
    Bus(#[from] BusError),
    /// The thread of the robot has ended.
    #[error("simulator: the simulated robot stopped by itself; see the log for the reason")]
    Ended,
}

/// Runs the simulated robot in front of a plane until it is stopped.
///
/// # Errors
/// A port is taken, or the bus refuses a topic or key.
pub fn run_franka(config: FciConfig, bus: Bus, stop: Stop) -> Result<(), FrankaError> {
    let plant = BenchPlant::new(&config.plant).map_err(FciStartError::from)?;
    run_franka_with(&config, Box::new(plant), &bus, &stop)
}

/// Runs the simulated robot with any plant until it is stopped.
///
/// # Errors
/// A port is taken, or the bus refuses a topic or key.
pub fn run_franka_with(
    config: &FciConfig,
    plant: Box<dyn TorquePlant>,
    bus: &Bus,
    stop: &Stop,
) -> Result<(), FrankaError> {
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
    let _answering = bus.answer(FAULT_KEY, move |_, request: Request| {
        let fault = FciFault::parse(&request.action, &request.argument);
        fault_answer(fault.map(|fault| {
            faults(fault);
            format!("{fault:?}")
        }))
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
            return Err(FrankaError::Ended);
        }
    }
    Ok(())
}
