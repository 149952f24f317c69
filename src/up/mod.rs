//! `tangent up`: the whole system against the simulator, in this process, from approach to report.

mod simulated_cell;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use tangent_control::Phase;
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, Role, Stop};

use crate::cli::Up;
use crate::compose::{self, RecorderExtra, Running};
use crate::follow::follow;
use crate::output::{Outcome, print_json};
use crate::scenarios::Played;
use crate::{control, report, scenarios};

/// Longest wait for the arm to be powered, its program to run and the sensor to stream.
const READY_PATIENCE: Duration = Duration::from_secs(30);

/// Runs the system, the task, and the report.
///
/// # Errors
/// A bad file, a busy port, or a service that cannot run.
pub fn run(args: &Up, base: CellConfig, json: bool) -> Result<Outcome> {
    let mut overrides = args.set.clone();
    if let Some(seed) = args.seed {
        overrides.push(format!("seed={seed}"));
    }
    let (scenario, task_file) = asked_for(args);
    let played = Played::load(scenario, &overrides)?;
    let task = match task_file {
        Some(file) => control::task_text(file)?,
        None => toml::to_string(played.task())?,
    };
    let mut config = match &played {
        Played::Normals(scenario) => simulated_cell::of_normals(base, scenario, args)?,
        Played::Object(scenario) => simulated_cell::of_object(base, scenario, args)?,
        Played::Tactile(scenario) => simulated_cell::of_tactile(base, scenario, args)?,
    };

    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    eprintln!(
        "cell {}: {} ({}); Ctrl-C retracts and stops",
        config.cell.name,
        played.title(),
        played.name()
    );
    config.zenoh.identify(roles::ROUTER);
    let bus = Bus::open_until(&config, Role::Router, Some(READY_PATIENCE), &stop)?;
    let extra = RecorderExtra {
        folder: Some(args.folder.clone()),
        attachments: vec![
            ("scenario.toml".to_owned(), played.text()?),
            ("task.toml".to_owned(), task.clone()),
        ],
    };
    let began = Instant::now();
    let mut system = System::start(&config, &played, &bus, &stop, &extra)?;
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

/// The scenario to play and the task file, if one is named: a system's name in the task's place means its scenario and task.
fn asked_for(args: &Up) -> (&str, Option<&Path>) {
    let default = args.scenario.as_deref().unwrap_or(scenarios::DEFAULT);
    let Some(file) = &args.task else {
        return (default, None);
    };
    match scenarios::of_system(&file.to_string_lossy()) {
        Some(own) => (args.scenario.as_deref().unwrap_or(own), None),
        None => (default, Some(file)),
    }
}

/// Everything that runs, in the order in which it is ended.
struct System {
    services: Vec<Running>,
}

impl System {
    fn start(
        config: &CellConfig,
        played: &Played,
        bus: &Bus,
        everybody: &Stop,
        extra: &RecorderExtra,
    ) -> Result<Self> {
        let simulator = compose::simulator(config, Some(played), bus, everybody)?;
        let recorder = compose::service("recorder", config, bus, everybody, extra)?;
        let mut services = Vec::new();
        // Registered before the arm's own service, a controller answers each packet within its publish.
        let names: &[&str] = match played {
            Played::Normals(_) => &["controller", "estimator", "netft", "rtde"],
            // This arm is on the bus itself.
            Played::Object(_) => &["controller", "estimator", "camera", "netft"],
            // This one feels by itself.
            Played::Tactile(_) if config.camera.is_some() => {
                &["controller", "estimator", "camera", "franka"]
            }
            Played::Tactile(_) => &["controller", "estimator", "franka"],
        };
        for name in names {
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
