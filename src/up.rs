//! `tangent up`: the whole system against the simulator, in this process, from approach to report.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use tangent_compose::RecorderExtra;
use tangent_control::Verdict;
use tangent_follow::Start;
use tangent_runtime::security::roles;
use tangent_runtime::{Bus, CellConfig, Role, Stop, ending, watchdog};
use tangent_simulated_cell::{GivenCell, RunningCell, run_cell_file, run_scenario, scenarios};
use tangent_simulation::Scenario;

use crate::cli::Up;
use crate::output::{Outcome, print_json};
use crate::task_file::task_text;
use crate::{live_view, terminal};

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
    let mut played = scenarios::load(&scenario, &overrides)?;
    let task = match task_file {
        Some(file) => task_text(file, &scenarios::systems())?,
        None => toml::to_string(played.task())?,
    };
    let mut config = as_run(args, &base, given, &mut played)?;
    tangent_check::before_start(&config, &task, || played.start_joints())?;

    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    ending::in_order(&stop);
    terminal::say(&format!(
        "cell {}: {} ({}); Ctrl-C retracts and stops",
        config.cell.name,
        played.title(),
        played.name()
    ));
    config.zenoh.identify(roles::ROUTER);
    // The simulated arm starts from the beginning in each run, so no state of an earlier run
    // applies.
    config.cell.state_folder = None;
    let bus = Bus::open_until(&config, Role::Router, Some(READY_PATIENCE), &stop)?;
    let _router = tangent_compose::router(&bus)?;
    let extra = RecorderExtra {
        folder: Some(args.folder.clone()),
        attachments: vec![
            ("scenario.toml".to_owned(), toml::to_string(&played)?),
            ("task.toml".to_owned(), task.clone()),
        ],
    };
    let cell = RunningCell::start(&config, &played, &bus, &stop, &extra)?;
    let ros2 = args
        .ros2
        .then(|| tangent_compose::service("ros2", &config, &bus, &stop, &extra))
        .transpose()?;
    let viewers = match args.foxglove {
        Some(address) => {
            config.foxglove.address = address.unwrap_or(config.foxglove.address);
            let service = tangent_compose::service("foxglove", &config, &bus, &stop, &extra)?;
            terminal::say(&for_viewers(&config));
            Some(service)
        }
        None => None,
    };
    watchdog::watch(&stop, None).context("starting the watchdog")?;
    let start = Start {
        action: "start",
        task: &task,
        patience: READY_PATIENCE,
    };
    terminal::say(&second_terminal(&config, &base, given));
    let ended = live_view::follow(&bus, &start, &stop, args.stay);
    let shown = ros2.map_or(Ok(()), tangent_compose::Running::end);
    let served = viewers.map_or(Ok(()), tangent_compose::Running::end);
    let recordings = cell.end(&args.folder)?;
    shown?;
    served?;
    let verdict = ended?.verdict();

    let (figures, page) = tangent_report::write_for(&recordings)?;
    if json {
        print_json(&figures)?;
    } else {
        print!("{}", tangent_report::words(&figures));
        for path in &recordings {
            println!("recording  {}", path.display());
        }
        println!("report     {}", page.display());
    }
    Ok(match verdict {
        Some(Verdict::Completed) if figures.accepted == Some(false) => Outcome::Failed,
        Some(Verdict::Completed) if figures.is_lossy() => Outcome::Lossy,
        Some(Verdict::Completed) => Outcome::Done,
        _ => Outcome::Failed,
    })
}

/// Where viewers connect.
fn for_viewers(config: &CellConfig) -> String {
    let address = config.foxglove.address;
    let open = if address.ip().is_loopback() {
        ""
    } else {
        "; anyone who reaches this address may read the cell's topics"
    };
    format!("for viewers: ws://{address}{open}")
}

/// The command that shows this cell from a second terminal.
fn second_terminal(config: &CellConfig, stated: &CellConfig, given: Option<&Path>) -> String {
    let mut options = String::new();
    if let Some(file) = given {
        options += &format!(" --cell {}", file.display());
    }
    if config.zenoh.connect != stated.zenoh.connect {
        for endpoint in &config.zenoh.connect {
            options += &format!(" --connect {endpoint}");
        }
    }
    format!(
        "in a second terminal: tangent status --watch{options} (or task pause, estimator list, topic list, ... with these \
         options)"
    )
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
        (None, None) if given => scenarios::of_cell(cell),
        (None, None) => scenarios::DEFAULT.to_owned(),
    };
    (scenario, task_file)
}

/// The cell as it runs: the file that was given, as far as it can be simulated, or one that fits
/// the scenario. Prints which settings of the file are not used.
fn as_run(
    args: &Up,
    base: &CellConfig,
    given: Option<&Path>,
    played: &mut Scenario,
) -> Result<CellConfig> {
    let Some(file) = given else {
        return Ok(run_scenario(base, played, args.port_offset)?);
    };
    let GivenCell { config, mut unused } = run_cell_file(base, file, played, args.port_offset)?;
    if base.recorder.folder != args.folder {
        let folder = args.folder.display();
        unused.push(format!("recorder.folder (recorded to --folder {folder})"));
    }
    terminal::say(&not_used(file, played, &unused));
    Ok(config)
}

/// One sentence that names the unused settings of the cell file.
fn not_used(file: &Path, played: &Scenario, unused: &[String]) -> String {
    let all = format!(
        "{} runs unchanged, against the surface, contact, sensor noise and start pose of scenario {}",
        file.display(),
        played.name()
    );
    if unused.is_empty() {
        return all;
    }
    format!(
        "{all}; these keys of it are not used: {}",
        unused.join(", ")
    )
}
