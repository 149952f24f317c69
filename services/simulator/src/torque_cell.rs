//! The torque-controlled cell: an arm with a torque interface and a Net F/T box beside it, around
//! one plant.

use std::net::IpAddr;

use nalgebra::Vector3;
use tangent_estimation::CORNERS;
use tangent_runtime::{Bus, BusError, HealthReporter, Stop};
use tangent_simulated_device::Ports;
use tangent_simulated_netft::{NetbBox, NetbError};
use tangent_simulation::{ObjectPlant, ObjectPlantConfig, PlantError};
use tangent_torque_arm::{SimulatedTorqueArm, TorqueArmError};

/// Configuration of the cell.
#[derive(Clone, Debug)]
pub struct TorqueCellConfig {
    /// Address that the sensor's box listens on.
    pub address: IpAddr,
    /// Ports of the box.
    pub ports: Ports,
    /// Arm, tool, object, sensor, camera.
    pub plant: ObjectPlantConfig,
    /// Corners of the target, object axes, m.
    pub corners_m: [Vector3<f64>; CORNERS],
    /// Seed of all randomness.
    pub seed: u64,
    /// SCHED_FIFO priority of the arm's and the box's threads; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

/// Why the service ended.
#[derive(Debug, thiserror::Error)]
pub enum TorqueCellError {
    /// The plant's configuration is wrong.
    #[error("simulator: {0}")]
    Plant(#[from] PlantError),
    /// The sensor box cannot start.
    #[error("simulator: {0}")]
    SensorBox(#[from] NetbError),
    /// The arm cannot start.
    #[error("simulator: {0}")]
    Arm(#[from] TorqueArmError),
    /// The bus refused a topic.
    #[error("simulator: {0}")]
    Bus(#[from] BusError),
}

/// Runs the cell until it is stopped.
///
/// # Errors
/// The configuration is wrong, a port is taken, or the bus refuses a topic.
pub fn run_torque_cell(
    config: &TorqueCellConfig,
    bus: &Bus,
    stop: &Stop,
) -> Result<(), TorqueCellError> {
    let health = HealthReporter::start_only(bus, "simulator")?;
    let plant = ObjectPlant::<6>::new(&config.plant, config.corners_m, config.seed)?;
    let sensor_box = NetbBox::for_sensor(
        config.address,
        config.ports,
        &config.plant.sensor,
        config.realtime_priority,
    )?;
    let arm = SimulatedTorqueArm::start(
        &config.plant,
        plant,
        config.realtime_priority,
        sensor_box.listener(),
        (bus, &health, stop),
    )?;
    tracing::info!(target: "simulator", "arm on the bus, sensor at {}", sensor_box.rdt_address());
    health.running();
    arm.join();
    Ok(())
}
