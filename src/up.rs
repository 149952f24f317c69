//! `tangent up`: the whole system against the simulator, in this process, from approach to report.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use nalgebra::{UnitQuaternion, Vector3};
use tangent_control::Phase;
use tangent_runtime::config::PoseConfig;
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, Role, Stop};
use tangent_simulation::Scenario;

use crate::cli::Up;
use crate::compose::{self, RecorderExtra, Running};
use crate::follow::follow;
use crate::output::{Outcome, bad_usage, print_json};
use crate::{control, report, scenarios};

/// Longest wait for the arm to be powered, its program to run and the sensor to stream.
const READY_PATIENCE: Duration = Duration::from_secs(30);

/// Runs the system, the task, and the report.
///
/// # Errors
/// A bad file, a busy port, or a service that cannot run.
pub fn run(args: &Up, base: CellConfig, json: bool) -> Result<Outcome> {
    let mut overrides = Vec::new();
    if let Some(seed) = args.seed {
        overrides.push(format!("seed={seed}"));
    }
    let scenario = scenarios::load(&args.scenario, &overrides)?;
    let task = task_text(args, &scenario)?;
    let mut config = simulated_cell(base, &scenario, args)?;

    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    eprintln!(
        "cell {}: {} ({}); Ctrl-C retracts and stops",
        config.cell.name, scenario.title, scenario.name
    );
    config.zenoh.identify(roles::ROUTER);
    let bus = Bus::open_until(&config, Role::Router, Some(READY_PATIENCE), &stop)?;
    let extra = RecorderExtra {
        folder: Some(args.folder.clone()),
        attachments: vec![
            ("scenario.toml".to_owned(), toml::to_string(&scenario)?),
            ("task.toml".to_owned(), task.clone()),
        ],
    };
    let began = Instant::now();
    let mut system = System::start(&config, &scenario, &bus, &stop, &extra)?;
    let wiped = follow(&bus, &task, &stop, READY_PATIENCE, args.stay);
    let recordings = system.end(&args.folder, began)?;
    let (phase, _) = wiped?;

    let (figures, page) = report::write_for(&recordings)?;
    if json {
        print_json(&figures)?;
    } else {
        print!("{}", report::words(&figures));
        for path in &recordings {
            println!("recording  {}", path.display());
        }
        println!("report     {}", page.display());
    }
    Ok(match phase {
        Phase::Done if figures.is_lossy() => Outcome::Lossy,
        Phase::Done => Outcome::Done,
        _ => Outcome::Failed,
    })
}

fn task_text(args: &Up, scenario: &Scenario) -> Result<String> {
    match &args.task {
        Some(file) => control::task_text(file),
        None => Ok(toml::to_string(&scenario.task)?),
    }
}

/// The cell file that fits the simulated cell: what a person would have measured and written down.
fn simulated_cell(mut cell: CellConfig, scenario: &Scenario, args: &Up) -> Result<CellConfig> {
    let tool = &scenario.plant.tool;
    let pose = |p: &tangent_simulation::PoseConfig| {
        let [roll, pitch, yaw] = p.roll_pitch_yaw_rad;
        let turn: Vector3<f64> = UnitQuaternion::from_euler_angles(roll, pitch, yaw).scaled_axis();
        PoseConfig {
            translation_m: p.position_m,
            rotation_vector_rad: turn.into(),
        }
    };
    cell.robot.model.clone_from(&scenario.plant.robot);
    cell.robot.address = "127.0.0.1".to_owned();
    cell.sensor.address = "127.0.0.1".to_owned();
    cell.robot.port_offset = offset(cell.robot.port_offset, args.port_offset)?;
    cell.sensor.port_offset = offset(cell.sensor.port_offset, args.port_offset)?;
    if args.port_offset > 0 {
        let protocol = if cell.zenoh.tls.is_some() {
            "quic"
        } else {
            "tcp"
        };
        let port = offset(7447, args.port_offset)?;
        let endpoint = format!("{protocol}/127.0.0.1:{port}");
        cell.zenoh.listen = vec![endpoint.clone()];
        cell.zenoh.connect = vec![endpoint];
    }
    cell.sensor.flange_from_sensor = pose(&tool.flange_from_sensor);
    cell.sensor.filter_cutoff_hz = scenario.sensing.filter_cutoff_hz;
    cell.tool.flange_from_tool = pose(&tool.flange_from_tool);
    cell.tool.mass_kg = tool.payload.mass_kg;
    cell.tool.com_in_sensor_m = tool.payload.com_in_sensor_m;
    cell.base = scenario.base;
    cell.controller.preset.clone_from(&scenario.controller);
    cell.controller.settings.clone_from(&scenario.control);
    cell.estimators
        .active
        .clone_from(&scenario.task.estimators[0]);
    for name in &scenario.task.estimators {
        if !cell.estimators.run.contains(name) {
            cell.estimators.run.push(name.clone());
        }
    }
    cell.estimators.settings.insert(
        tangent_estimator::ALL.to_owned(),
        toml::Table::try_from(scenario.estimation)?,
    );
    Ok(cell)
}

fn offset(port: u16, by: u16) -> Result<u16> {
    // The highest port in use is the sensor's, 49152.
    match port.checked_add(by) {
        Some(sum) if sum <= u16::MAX - 49_152 || port >= 7447 => Ok(sum),
        _ => Err(bad_usage(format!(
            "--port-offset {by}: must keep every port below 65536; 0 to 16383 is allowed"
        ))),
    }
}

/// Everything that runs, in the order in which it is ended.
struct System {
    services: Vec<Running>,
}

impl System {
    fn start(
        config: &CellConfig,
        scenario: &Scenario,
        bus: &Bus,
        everybody: &Stop,
        extra: &RecorderExtra,
    ) -> Result<Self> {
        let simulator = compose::simulator(config, Some(scenario), bus, everybody)?;
        let recorder = compose::service("recorder", config, bus, everybody, extra)?;
        let mut services = Vec::new();
        for name in ["controller", "estimator", "netft", "rtde"] {
            services.push(compose::service(name, config, bus, everybody, extra)?);
        }
        // The bridge says goodbye to the robot before the robot goes; the recorder hears everybody's last word.
        services.reverse();
        services.push(simulator);
        services.push(recorder);
        Ok(Self { services })
    }

    /// Ends everything and returns the recordings made since `began`.
    fn end(&mut self, folder: &std::path::Path, began: Instant) -> Result<Vec<PathBuf>> {
        let mut failed = None;
        for service in self.services.drain(..) {
            if let Err(error) = service.end() {
                failed.get_or_insert(error);
            }
        }
        if let Some(error) = failed {
            return Err(error);
        }
        let age = began.elapsed();
        let mut files = Vec::new();
        let entries = fs::read_dir(folder)
            .with_context(|| format!("listing recordings in {}", folder.display()))?;
        for entry in entries.flatten() {
            let path = entry.path();
            let recent = entry
                .metadata()
                .and_then(|m| m.modified())
                .is_ok_and(|at| at.elapsed().is_ok_and(|e| e <= age));
            if path.extension().is_some_and(|e| e == "mcap") && recent {
                files.push(path);
            }
        }
        files.sort();
        if files.is_empty() {
            bail!("no recording was written to {}", folder.display());
        }
        Ok(files)
    }
}
