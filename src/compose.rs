//! Puts services into this process: each in a thread of its own, all on one bus.

use std::path::PathBuf;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use tangent_mechanics::ModelData;
use tangent_runtime::config::{Law, RobotDriver};
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, HealthReporter, Stop};
use tangent_schemas::topics::SIMULATED_IMAGE;
use tangent_simulation::{NormalSource, ObjectScenario, Scenario, TactileScenario};
use tangent_simulator::fci::{DepthEye, FciConfig, Plane, PlantConfig, TactileArm, TorquePlant};
use tangent_simulator::{Flavour, Ports};

use crate::output::bad_usage;
use crate::scenarios::{self, Played};
use crate::simulated_plant;

/// The router answered a moment ago.
const NETWORK_PATIENCE: Duration = Duration::from_secs(10);

/// The arm model that the cell names: built in, or the user's own file.
///
/// # Errors
/// An unknown name or a bad file.
pub fn model(config: &CellConfig) -> Result<ModelData> {
    match &config.robot.model_file {
        Some(path) => crate::model::load_file(path),
        None => ModelData::builtin(&config.robot.model)
            .map_err(|e| bad_usage(format!("[robot] model: {e}"))),
    }
}

/// A service running in a thread of this process.
pub struct Running {
    name: &'static str,
    stop: Stop,
    thread: JoinHandle<Result<()>>,
}

impl Running {
    /// Starts `body` in a thread. It ends when its own [`Stop`] is triggered; when it ends by
    /// itself, `everybody` is triggered, so that no service continues without it. A panic in it
    /// ends the process, see [`tangent_runtime::ending`].
    ///
    /// # Errors
    /// When the system has no thread to give.
    pub fn start(
        name: &'static str,
        everybody: &Stop,
        body: impl FnOnce(Stop) -> Result<()> + Send + 'static,
    ) -> Result<Self> {
        let stop = Stop::new();
        let (own, everybody) = (stop.clone(), everybody.clone());
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                let mut ended = body(own.clone());
                if ended.is_ok() && !own.is_stopped() && !everybody.is_stopped() {
                    ended = Err(anyhow!("ended by itself; this is a defect"));
                }
                if let Err(error) = &ended {
                    tracing::error!("{name}: {error:#}; all services of this process end");
                    everybody.trigger();
                }
                ended
            })
            .with_context(|| format!("starting the thread of {name}"))?;
        Ok(Self { name, stop, thread })
    }

    /// Ends the service and waits for it.
    ///
    /// # Errors
    /// What the service ended with.
    pub fn end(self) -> Result<()> {
        self.stop.trigger();
        self.thread
            .join()
            .unwrap_or_else(|_| Err(anyhow!("panicked; this is a defect")))
            .with_context(|| self.name.to_owned())
    }
}

/// Says how this process fares as the cell's router, until it is dropped.
///
/// # Errors
/// When the bus refuses it.
pub fn router(bus: &Bus) -> Result<HealthReporter> {
    let health = HealthReporter::start(bus, roles::ROUTER)?;
    health.running();
    Ok(health)
}

/// Starts one service by its name.
///
/// # Errors
/// A cell file that does not fit the service.
pub fn service(
    name: &str,
    config: &CellConfig,
    bus: &Bus,
    everybody: &Stop,
    extra: &RecorderExtra,
) -> Result<Running> {
    let bus = bus.clone();
    match name {
        "netft" => {
            let config = tangent_netft::Config::from_cell(config);
            Running::start("netft", everybody, move |stop| {
                Ok(tangent_netft::run(config, bus, stop)?)
            })
        }
        "rtde" => {
            let config = tangent_rtde::Config::from_cell(config).map_err(bad_usage)?;
            Running::start("rtde", everybody, move |stop| {
                Ok(tangent_rtde::run(config, bus, stop)?)
            })
        }
        "franka" => {
            let config = tangent_franka::Config::from_cell(config).map_err(bad_usage)?;
            Running::start("franka", everybody, move |stop| {
                Ok(tangent_franka::run(config, bus, stop)?)
            })
        }
        "estimator" => {
            let config =
                tangent_estimator::Config::from_cell(config, model(config)?).map_err(bad_usage)?;
            Running::start("estimator", everybody, move |stop| {
                Ok(tangent_estimator::run(config, bus, stop)?)
            })
        }
        "camera" => {
            let config = tangent_camera::Config::from_cell(config).map_err(bad_usage)?;
            Running::start("camera", everybody, move |stop| {
                Ok(tangent_camera::run(config, bus, stop)?)
            })
        }
        "controller" if config.controller.law != Law::HybridAdmittance => {
            let config = tangent_controller::TorqueConfig::from_cell(config, &model(config)?)
                .map_err(bad_usage)?;
            Running::start("controller", everybody, move |stop| {
                Ok(tangent_controller::run_torque(config, bus, stop)?)
            })
        }
        "controller" => {
            let config =
                tangent_controller::Config::from_cell(config, model(config)?).map_err(bad_usage)?;
            Running::start("controller", everybody, move |stop| {
                Ok(tangent_controller::run(config, bus, stop)?)
            })
        }
        "recorder" => {
            let recorder = recorder(config, extra);
            let zenoh = config.zenoh.clone();
            Running::start("recorder", everybody, move |stop| {
                if recorder.cells.is_empty() {
                    tangent_recorder::run(recorder, bus, stop)?;
                } else {
                    // Beside the cell's own session, one that hears all cells.
                    let network = Bus::open_network(&zenoh, NETWORK_PATIENCE)?;
                    tangent_recorder::run_for(recorder, bus, network, stop)?;
                }
                Ok(())
            })
        }
        other => Err(bad_usage(format!("there is no service \"{other}\""))),
    }
}

/// Starts the simulated cell: the given scenario's, or the one that the cell file names.
///
/// # Errors
/// A scenario that cannot be read.
pub fn simulator(
    config: &CellConfig,
    played: Option<&Played>,
    bus: &Bus,
    everybody: &Stop,
) -> Result<Running> {
    if config.robot.driver == RobotDriver::Franka
        && played.is_none()
        && config.simulator.scenario.is_none()
    {
        return simulated_franka(config, None, bus, everybody);
    }
    let own = match (played, &config.simulator.scenario) {
        (Some(_), _) => None,
        (None, Some(path)) => Some(own_scenario(config, &path.display().to_string())?),
        (None, None) => Some(own_scenario(config, scenarios::DEFAULT)?),
    };
    match played.or(own.as_ref()) {
        Some(Played::Object(scenario)) => simulated_object(config, scenario, bus, everybody),
        Some(Played::Tactile(scenario)) => simulated_franka(config, Some(scenario), bus, everybody),
        Some(Played::Normals(scenario)) => simulated_normals(config, scenario, bus, everybody),
        None => Err(anyhow!("no scenario to play; this is a defect")),
    }
}

/// A scenario by name or file, with the cell's arm.
fn own_scenario(config: &CellConfig, name: &str) -> Result<Played> {
    let mut played = Played::load(name, &[])?;
    simulated_plant::take_arm(&mut played, config);
    Ok(played)
}

/// An arm with a torque interface on the bus, a sensor's box, a camera.
fn simulated_object(
    config: &CellConfig,
    scenario: &ObjectScenario,
    bus: &Bus,
    everybody: &Stop,
) -> Result<Running> {
    let mut plant = scenario.plant.clone();
    plant.sensor.rate_hz = config.sensor.rate_hz;
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
    Running::start("simulator", everybody, move |stop| {
        Ok(tangent_simulator::run_torque_cell(&simulated, &bus, &stop)?)
    })
}

fn simulated_normals(
    config: &CellConfig,
    scenario: &Scenario,
    bus: &Bus,
    everybody: &Stop,
) -> Result<Running> {
    let mut plant = scenario.plant.clone();
    // The box sends at the rate that the cell asks for; the physics do not depend on it.
    plant.sensor.rate_hz = config.sensor.rate_hz;
    let flavour = if plant.arm.period_s < 0.004 {
        Flavour::ESeries
    } else {
        Flavour::Cb3
    };
    let simulated = tangent_simulator::Config {
        address: config.simulator.address,
        ports: Ports::Offset(config.robot.port_offset),
        controller: tangent_simulator::ControllerConfig {
            flavour,
            ..tangent_simulator::ControllerConfig::default()
        },
        plant,
        seed: config.simulator.seed.unwrap_or(scenario.seed),
        realtime_priority: config
            .realtime
            .enabled
            .then_some(config.realtime.simulator_priority),
    };
    let bus = bus.clone();
    Running::start("simulator", everybody, move |stop| {
        Ok(tangent_simulator::run(simulated, bus, stop)?)
    })
}

/// A simulated Franka with the cell's tool. Without a scenario of its own there is a table under
/// the tool to press on.
fn simulated_franka(
    config: &CellConfig,
    scenario: Option<&TactileScenario>,
    bus: &Bus,
    everybody: &Stop,
) -> Result<Running> {
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
        // A machine that simulates the robot too may be late: simulated time waits, where a robot
        // would stop by itself.
        answer_wait_s: ANSWER_WAIT_S,
        ..FciConfig::default()
    };
    let bus = bus.clone();
    let Some(scenario) = scenario else {
        return Running::start("simulator", everybody, move |stop| {
            Ok(tangent_simulator::fci::run(simulated, bus, stop)?)
        });
    };
    let seed = config.simulator.seed.unwrap_or(scenario.seed);
    let delay_periods = config.robot.franka().delay_periods;
    let mut plant = TactileArm::new(&scenario.plant, delay_periods, seed).map_err(bad_usage)?;
    if scenario.plant.normals_from == NormalSource::Depth {
        let camera = &scenario.plant.depth_camera;
        let eye = DepthEye::new(
            camera,
            &plant.flange_from_tool(),
            seed,
            plant.surface().clone(),
            bus.publisher(&SIMULATED_IMAGE)?,
        );
        let looks = eye
            .map_err(bad_usage)?
            .start(config.realtime.enabled)
            .context("starting the thread of the simulated depth camera")?;
        plant.watched_by(looks, camera.rate_hz);
    }
    Running::start("simulator", everybody, move |stop| {
        Ok(tangent_simulator::fci::run_with(
            &simulated,
            Box::new(plant),
            &bus,
            &stop,
        )?)
    })
}

/// How long the simulated Franka waits for an answer, s.
const ANSWER_WAIT_S: f64 = 0.01;

/// Horizontal, well below the tool at the arm's home.
const TABLE: Plane = Plane {
    point_m: [0.0, 0.0, 0.2],
    normal: [0.0, 0.0, 1.0],
    stiffness_n_per_m: 10_000.0,
    damping_n_s_per_m: 50.0,
    friction: 0.3,
};

/// What a recording holds besides the topics.
#[derive(Clone, Debug, Default)]
pub struct RecorderExtra {
    /// Folder in place of the cell's.
    pub folder: Option<PathBuf>,
    /// Files to store inside: name and text.
    pub attachments: Vec<(String, String)>,
}

fn recorder(config: &CellConfig, extra: &RecorderExtra) -> tangent_recorder::RecorderConfig {
    let mut recorder = tangent_recorder::RecorderConfig::from_cell(config)
        .with_attachment("cell.toml", config.text());
    if let Some(folder) = &extra.folder {
        recorder.folder.clone_from(folder);
    }
    recorder.attachments.extend(extra.attachments.clone());
    recorder
}
