//! Simulated devices of a cell, by the kind of arm. They take ports, rates and real-time settings
//! from the cell file, and the plant from a scenario.

use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_schemas::topics::SIMULATED_IMAGE;
use tangent_simulated_device::{Ports, Shutter};
use tangent_simulated_franka::{FciConfig, Plane, PlantConfig, TactileArm};
use tangent_simulated_ur::{ControllerConfig, Flavour};
use tangent_simulation::{AdmittanceScenario, NormalSource, ObjectScenario, VisuoTactileScenario};

use crate::error::ComposeError;
use crate::running::Running;

/// Starts the cell of an object-pose scenario: an arm with a torque interface on the bus, a
/// simulated sensor box and a camera.
///
/// # Errors
/// The system cannot start another thread.
pub fn torque_arm(
    config: &CellConfig,
    scenario: &ObjectScenario,
    bus: &Bus,
    process_stop: &Stop,
) -> Result<Running, ComposeError> {
    let mut plant = scenario.plant.clone();
    plant.sensor.rate_hz = config.sensor.rate_max_hz();
    let simulated = tangent_simulator::TorqueCellConfig {
        address: config.simulator.address,
        ports: Ports::Offset(config.sensor.port_offset),
        plant,
        corners_m: scenario.estimation.target.corners(),
        seed: config.simulator.seed.unwrap_or(scenario.seed),
        realtime_priority: config
            .realtime
            .enabled
            .then_some(config.realtime.simulator_priority),
    };
    let bus = bus.clone();
    Running::start("simulator", process_stop, move |stop| {
        Ok(tangent_simulator::run_torque_cell(&simulated, &bus, &stop)?)
    })
}

/// Starts the cell of a scenario with a velocity-controlled arm: a UR controller and a simulated
/// sensor box.
///
/// # Errors
/// The system cannot start another thread.
pub fn velocity_arm(
    config: &CellConfig,
    scenario: &AdmittanceScenario,
    bus: &Bus,
    process_stop: &Stop,
) -> Result<Running, ComposeError> {
    let mut plant = scenario.plant.clone();
    // The sensor box sends at the rate that the cell configures; the physics do not depend on it.
    plant.sensor.rate_hz = config.sensor.rate_max_hz();
    let flavour = if plant.arm.period_s < 0.004 {
        Flavour::ESeries
    } else {
        Flavour::Cb3
    };
    let simulated = tangent_simulator::Config {
        address: config.simulator.address,
        ports: Ports::Offset(config.robot.port_offset),
        controller: ControllerConfig {
            flavour,
            ..ControllerConfig::default()
        },
        plant,
        seed: config.simulator.seed.unwrap_or(scenario.seed),
        realtime_priority: config
            .realtime
            .enabled
            .then_some(config.realtime.simulator_priority),
    };
    let bus = bus.clone();
    Running::start("simulator", process_stop, move |stop| {
        Ok(tangent_simulator::run(simulated, bus, stop)?)
    })
}

/// Starts a simulated Franka with the cell's tool. Without a scenario, the plant has a table under
/// the tool to press on.
///
/// # Errors
/// The plant cannot be built, or the system cannot start another thread.
pub fn franka(
    config: &CellConfig,
    scenario: Option<&VisuoTactileScenario>,
    bus: &Bus,
    process_stop: &Stop,
) -> Result<Running, ComposeError> {
    let tool = config.tool.flange_from_tool();
    let com = config
        .sensor
        .flange_from_sensor()
        .transform_point(&config.tool.com_in_sensor());
    let simulated = FciConfig {
        address: config.simulator.address,
        ports: Ports::Offset(config.robot.port_offset),
        plant: PlantConfig {
            tool_m: tool.translation().into(),
            tool_rotation_rad: tool.rotation().scaled_axis().into(),
            tool_mass_kg: config.tool.mass_kg,
            tool_com_m: com.into(),
            plane: Some(TABLE),
            ..PlantConfig::default()
        },
        realtime_priority: config
            .realtime
            .enabled
            .then_some(config.realtime.simulator_priority),
        // A machine that also simulates the robot may be late. Simulated time then waits, where a
        // real robot would stop by itself.
        answer_wait_s: ANSWER_WAIT_S,
        ..FciConfig::default()
    };
    let bus = bus.clone();
    let Some(scenario) = scenario else {
        return Running::start("simulator", process_stop, move |stop| {
            Ok(tangent_simulator::run_franka(simulated, bus, stop)?)
        });
    };
    let seed = config.simulator.seed.unwrap_or(scenario.seed);
    let delay_periods = config.robot.franka().delay_periods;
    let mut plant =
        TactileArm::new(&scenario.plant, delay_periods, seed).map_err(ComposeError::refused)?;
    if scenario.plant.normals_from == NormalSource::Depth {
        let camera = &scenario.plant.depth_camera;
        let shutter = Shutter::start(
            camera,
            &plant.true_flange_from_tool(),
            seed,
            plant.surface(),
            bus.publisher(&SIMULATED_IMAGE)?,
            config.realtime.enabled,
        )
        .map_err(ComposeError::refused)?;
        plant.watched_by(shutter);
    }
    Running::start("simulator", process_stop, move |stop| {
        Ok(tangent_simulator::run_franka_with(
            &simulated,
            Box::new(plant),
            &bus,
            &stop,
        )?)
    })
}

/// Longest wait of the simulated Franka for an answer, s.
const ANSWER_WAIT_S: f64 = 0.01;

/// The table: horizontal, well below the tool at the arm's home position.
const TABLE: Plane = Plane {
    point_m: [0.0, 0.0, 0.2],
    normal: [0.0, 0.0, 1.0],
    stiffness_n_per_m: 10_000.0,
    damping_n_s_per_m: 50.0,
    friction: 0.3,
};
