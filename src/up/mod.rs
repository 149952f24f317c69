//! `tangent up`: the whole system against the simulator, in this process, from approach to report.

mod cell_keys;
mod given_cell;
mod simulated_cell;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use tangent_control::Phase;
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, Role, Stop, ending, watchdog};
use toml::{Table, Value};

use crate::cli::Up;
use crate::compose::{self, RecorderExtra, Running};
use crate::follow::follow;
use crate::output::{Outcome, bad_usage, print_json};
use crate::scenarios::Played;
use crate::{check, control, report, scenarios};

use cell_keys::{get, set};

/// Longest wait for the arm to be powered, its program to run and the sensor to stream.
const READY_PATIENCE: Duration = Duration::from_secs(30);

/// Runs the system, the task, and the report. `given` is the cell file that the user named.
///
/// # Errors
/// A bad file, a task that the cell would refuse, a busy port, or a service that cannot run.
pub fn run(args: &Up, base: CellConfig, given: Option<&Path>, json: bool) -> Result<Outcome> {
    let mut overrides = args.set.clone();
    if let Some(seed) = args.seed {
        overrides.push(format!("seed={seed}"));
    }
    let (scenario, task_file) = asked_for(args, &base, given.is_some());
    let mut played = Played::load(&scenario, &overrides)?;
    let task = match task_file {
        Some(file) => control::task_text(file)?,
        None => toml::to_string(played.task())?,
    };
    let mut config = as_run(args, &base, given, &mut played)?;
    check::before_start(&config, &task, &played)?;

    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    ending::in_order(&stop);
    eprintln!(
        "cell {}: {} ({}); Ctrl-C retracts and stops",
        config.cell.name,
        played.title(),
        played.name()
    );
    config.zenoh.identify(roles::ROUTER);
    // The simulated arm begins anew with each run: nothing is left of the one before.
    config.cell.state_folder = None;
    let bus = Bus::open_until(&config, Role::Router, Some(READY_PATIENCE), &stop)?;
    let _router = compose::router(&bus)?;
    let extra = RecorderExtra {
        folder: Some(args.folder.clone()),
        attachments: vec![
            ("scenario.toml".to_owned(), played.text()?),
            ("task.toml".to_owned(), task.clone()),
        ],
    };
    let began = Instant::now();
    let mut system = System::start(&config, &played, &bus, &stop, &extra)?;
    watchdog::watch(&stop, None).context("starting the watchdog")?;
    let wiped = follow(&bus, "start", &task, &stop, READY_PATIENCE, args.stay);
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

/// The scenario to play and the task file, if one is named: a system's name in the task's place
/// means its scenario and task.
fn asked_for<'a>(args: &'a Up, cell: &CellConfig, given: bool) -> (String, Option<&'a Path>) {
    let system = args
        .task
        .as_ref()
        .and_then(|task| scenarios::of_system(&task.to_string_lossy()));
    let task_file = args.task.as_deref().filter(|_| system.is_none());
    let scenario = match (&args.scenario, system) {
        (Some(named), _) => named.clone(),
        (None, Some(own)) => own.to_owned(),
        (None, None) if given => given_cell::scenario(cell),
        (None, None) => scenarios::DEFAULT.to_owned(),
    };
    (scenario, task_file)
}

/// The cell that fits a scenario.
///
/// # Errors
/// An unknown arm, or a value that no cell may have.
pub fn cell_of(played: &Played) -> Result<CellConfig> {
    let base = CellConfig::default_cell();
    let mut written = Ok(());
    let config = base.changed(&format!("the cell of scenario {}", played.name()), |cell| {
        written = simulated_cell::write(cell, &base, played);
    });
    written?;
    config.map_err(bad_usage)
}

/// The cell as it runs: the file that was given, as far as it can be simulated, or one that fits
/// the scenario. Its text is what is recorded.
fn as_run(
    args: &Up,
    base: &CellConfig,
    given: Option<&Path>,
    played: &mut Played,
) -> Result<CellConfig> {
    let title = match given {
        Some(file) => format!("{} as `tangent up` runs it", file.display()),
        None => format!("the cell of scenario {}", played.name()),
    };
    let mut written = Ok(Vec::new());
    if given.is_some() {
        given_cell::fit(base, played)?;
    }
    let played = &*played;
    let config = base.changed(&title, |cell| {
        written = match given {
            Some(_) => given_cell::write(cell, base, played),
            None => simulated_cell::write(cell, base, played).map(|()| Vec::new()),
        };
        if written.is_ok()
            && let Err(error) = on_this_machine(cell, args)
        {
            written = Err(error);
        }
    });
    let mut unused = written?;
    if base.recorder.folder != args.folder {
        let folder = args.folder.display();
        unused.push(format!("recorder.folder (recorded to --folder {folder})"));
    }
    let config = config.map_err(bad_usage)?;
    if let Some(file) = given {
        eprintln!("{}", not_used(file, played, &unused));
    }
    Ok(config)
}

/// One sentence on what of the cell file is not used.
fn not_used(file: &Path, played: &Played, unused: &[String]) -> String {
    let all = format!(
        "{} runs as it stands, against the surface, contact, sensor noise and start pose of scenario {}",
        file.display(),
        played.name()
    );
    if unused.is_empty() {
        return all;
    }
    format!("{all}; not used of it: {}", unused.join(", "))
}

/// Addresses and ports of a cell that is simulated here.
fn on_this_machine(cell: &mut Table, args: &Up) -> Result<()> {
    set(cell, "robot.address", "127.0.0.1")?;
    set(cell, "sensor.address", "127.0.0.1")?;
    set(cell, "simulator.address", "127.0.0.1")?;
    for key in ["robot.port_offset", "sensor.port_offset"] {
        let own = get(cell, key).and_then(Value::as_integer).unwrap_or(0);
        let own = u16::try_from(own).unwrap_or(u16::MAX);
        set(cell, key, offset(own, args.port_offset)?)?;
    }
    if args.port_offset > 0 {
        let tls = get(cell, "zenoh.tls").is_some();
        let protocol = if tls { "quic" } else { "tcp" };
        let port = offset(7447, args.port_offset)?;
        let endpoint = format!("{protocol}/127.0.0.1:{port}");
        set(cell, "zenoh.listen", [&endpoint])?;
        set(cell, "zenoh.connect", [&endpoint])?;
    }
    Ok(())
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
        played: &Played,
        bus: &Bus,
        everybody: &Stop,
        extra: &RecorderExtra,
    ) -> Result<Self> {
        let simulator = compose::simulator(config, Some(played), bus, everybody)?;
        let recorder = compose::service("recorder", config, bus, everybody, extra)?;
        let mut services = Vec::new();
        // Registered before the arm's own service, a controller answers each packet within its
        // publish.
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
        // The bridge says goodbye to the robot before the robot goes; the recorder hears
        // everybody's last word.
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
