//! The command line: what can be asked for, and the help that explains it.

mod bench;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

pub use bench::{Bench, BenchBus, BenchPeer, BenchRequests, BenchRole};

/// Keep a robot's tool pressed on a surface nobody has modelled.
#[derive(Debug, Parser)]
#[command(name = "tangent", version, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,

    /// Print one JSON object on standard output instead of words.
    #[arg(long, global = true)]
    pub json: bool,

    /// The cell's configuration file; the built-in simulated cell if none is named. For `report`
    /// also a cell's name.
    #[arg(long, global = true, value_name = "FILE", env = "TANGENT_CELL")]
    pub cell: Option<PathBuf>,

    /// Who this process is on a network with certificates, as in `tangent keys list`; by default
    /// what it runs says it.
    #[arg(long, global = true, value_name = "NAME")]
    pub identity: Option<String>,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the whole system against the simulator on this machine: approach, wipe, retract,
    /// recording and report.
    Up(Up),
    /// Run one or more services in this process.
    Run(Run),
    /// Start, pause, resume or stop the cell's task.
    #[command(subcommand)]
    Task(TaskCommand),
    /// See who publishes normals, and choose whose are used.
    #[command(subcommand)]
    Estimator(EstimatorCommand),
    /// Set the force sensor's zero: the tool must hang free.
    Tare {
        /// You have looked: the tool hangs free. Overrides what speaks against it, but not a
        /// controller that moves or presses.
        #[arg(long)]
        clear: bool,
    },
    /// Measure what the cell file has to say about the sensor.
    #[command(subcommand)]
    Calibrate(CalibrateCommand),
    /// Read or set live parameters.
    #[command(subcommand)]
    Param(ParamCommand),
    /// Services, rates, ages and faults of the cell.
    Status(Status),
    /// Ask whether services are well: exit code 0 when all are, else 1.
    Health(Health),
    /// Record every topic of the cell until Ctrl-C.
    Record(Record),
    /// Read a recording: figures, and a page with plots.
    Report(Report),
    /// Certificates and access rules for the network of one or more cells.
    #[command(subcommand)]
    Keys(KeysCommand),
    /// Run a scenario in a closed loop without hardware or network, faster than real time.
    Evaluate(Evaluate),
    /// Reproduce a paper's tables beside ours.
    Reproduce(Reproduce),
    /// Provoke every failure on a private simulated cell, and measure who notices when, and when
    /// the arm is safe.
    Faults(Faults),
    /// Can this machine do it? Scheduling, memory, kernel, network, ports, disk, clock, robot and
    /// sensor, and what to do.
    Doctor(Doctor),
    /// Check files offline, with everything that would be refused later: cells, tasks, scenarios
    /// and robot models. Exit code 0 or 2.
    Check(Check),
    /// The robot's own modes: leave a protective stop, power, the bridge's program.
    #[command(subcommand)]
    Robot(RobotCommand),
    /// Robot models: list them, show one, or check them against reference values.
    #[command(subcommand)]
    Model(ModelCommand),
    /// Measure on this machine: each step by itself, or messages over the bus.
    #[command(subcommand)]
    Bench(Bench),
}

/// Options of `tangent up`.
#[derive(Debug, Args)]
pub struct Up {
    /// Task file, or a system's name: tugal, lippiello, karacan. The scenario's own task if none is
    /// named.
    pub task: Option<PathBuf>,
    /// Scenario that the simulator plays: a name from `scenarios/` or a file; the system's own, or
    /// pipe_realistic.
    #[arg(long)]
    pub scenario: Option<String>,
    /// Seed of the simulator's noise.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Override one key of the scenario, `KEY.PATH=VALUE`; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder for the recording and the report.
    #[arg(long, default_value = "recordings")]
    pub folder: PathBuf,
    /// Added to every port of the simulated robot and sensor, and to the router's.
    #[arg(long, default_value_t = 0)]
    pub port_offset: u16,
    /// Keep the system running after the task, until Ctrl-C.
    #[arg(long)]
    pub stay: bool,
}

/// Options of `tangent run`.
#[derive(Debug, Args)]
pub struct Run {
    /// Any of router, netft, rtde, franka, camera, estimator, controller, recorder, simulator.
    #[arg(required = true, value_parser = ["router", "netft", "rtde", "franka", "camera", "estimator", "controller", "recorder", "simulator"])]
    pub services: Vec<String>,
    /// Estimators that the estimator service of this process runs, in place of the cell file's
    /// list; commas between them.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub estimators: Vec<String>,
}

/// Options of `tangent health`.
#[derive(Debug, Args)]
pub struct Health {
    /// Services: router, netft, rtde, franka, camera, estimator, controller, recorder, simulator,
    /// or one of your own.
    #[arg(required = true)]
    pub services: Vec<String>,
    /// Only those on this host (in a container: in this container).
    #[arg(long)]
    pub here: bool,
    /// Seconds to listen for a service, which tells its health once a second.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = seconds)]
    pub patience_s: f64,
}

/// Seconds a person may ask to wait.
fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(s) if (0.0..=86_400.0).contains(&s) => Ok(s),
        _ => Err("allowed are 0 to 86400 seconds".to_owned()),
    }
}

/// What to do with a task.
#[derive(Debug, Subcommand)]
pub enum TaskCommand {
    /// Start the task in a file.
    Start {
        /// Task file (TOML).
        file: PathBuf,
        /// Wait so many seconds for the cell to be there and ready, instead of failing at once.
        #[arg(long, value_name = "SECONDS", value_parser = seconds)]
        wait_s: Option<f64>,
        /// Stay until the task ends, and show it; Ctrl-C or SIGTERM retracts. Exit code 0 when the
        /// task is done.
        #[arg(long)]
        follow: bool,
        /// You have looked: the tool hangs free, whatever the last task left.
        #[arg(long)]
        clear: bool,
    },
    /// Stop sliding, keep the force.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Retract and end the task.
    Stop,
    /// What the controller does now.
    Status,
}

/// What to do with estimators.
#[derive(Debug, Subcommand)]
pub enum EstimatorCommand {
    /// Who publishes normals, where, how old, how far from the one in use.
    List,
    /// All estimators side by side: live, or from a recording.
    Compare(Compare),
    /// Use another estimator from now on.
    Use {
        /// Its name, as in `estimate/NAME/normal`.
        name: String,
        /// Switch although the newcomer is invalid or disagrees; recorded. One that is silent is
        /// refused all the same.
        #[arg(long)]
        force: bool,
    },
}

/// Options of `tangent estimator compare`.
#[derive(Debug, Args)]
pub struct Compare {
    /// Recording (`.mcap`) to read; the live cell if none is named.
    pub file: Option<PathBuf>,
    /// Listen to the live cell for so long.
    #[arg(long, default_value_t = 5.0, value_parser = parse_seconds)]
    pub seconds: f64,
}

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum CalibrateCommand {
    /// Mass and centre of mass of what hangs on the sensor, from readings in several orientations
    /// of the arm.
    Payload(CalibratePayload),
}

/// Options of `tangent calibrate payload`.
#[derive(Debug, Args)]
pub struct CalibratePayload {
    /// Poses to take, each at an Enter: well spread, the first once more at the end.
    #[arg(long, default_value_t = 9, value_parser = clap::value_parser!(u16).range(6..=200))]
    pub poses: u16,
    /// Take every stand of the arm from a recording instead.
    #[arg(long, value_name = "FILE", conflicts_with = "poses")]
    pub from: Option<PathBuf>,
}

/// What to do with parameters.
#[derive(Debug, Subcommand)]
pub enum ParamCommand {
    /// Print one parameter, or all of a service, or all.
    Get {
        /// `SERVICE/NAME`, `SERVICE`, or nothing.
        name: Option<String>,
    },
    /// Set a parameter; the service ramps to it where a step would jerk the arm.
    Set {
        /// `SERVICE/NAME`.
        name: String,
        /// New value, in the parameter's unit.
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
}

/// Options of `tangent status`.
#[derive(Debug, Args)]
pub struct Status {
    /// Every cell on the router's network, not only this one.
    #[arg(long)]
    pub all: bool,
}

/// What to do with certificates.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Make an authority, a certificate for each identity, and the router's access rules; what is
    /// there is kept.
    New(NewKeys),
    /// Lock identities out for good: the router takes them from its access rules, and their names
    /// are not given again.
    Revoke {
        /// Folder, as given to `new`.
        folder: PathBuf,
        /// Identities, as in `tangent keys list`.
        #[arg(required = true)]
        identities: Vec<String>,
    },
    /// Whose certificates are in a folder, and how long they hold.
    List {
        /// Folder, as given to `new`.
        folder: PathBuf,
    },
}

/// Options of `tangent keys new`.
#[derive(Debug, Args)]
pub struct NewKeys {
    /// Folder for all files; made when it does not exist.
    pub folder: PathBuf,
    /// Name of a cell; may be repeated. Cells that the folder has already stay.
    #[arg(long = "for", value_name = "CELL")]
    pub cells: Vec<String>,
    /// Name or address under which the router is dialled, besides localhost; may be repeated. Those
    /// it has already stay.
    #[arg(long = "host", value_name = "HOST")]
    pub hosts: Vec<String>,
    /// A host that runs estimators: an identity of its own in each cell, `estimator-NAME.CELL`,
    /// that can be revoked alone; may be repeated.
    #[arg(long = "estimator-host", value_name = "NAME")]
    pub estimator_hosts: Vec<String>,
    /// A further holder of a role, `ROLE-NAME.CELL` or `ROLE-NAME`, for instance operator-anna; may
    /// be repeated.
    #[arg(long, value_name = "IDENTITY")]
    pub also: Vec<String>,
    /// Make this identity's certificate anew, with the names that it has; may be repeated.
    #[arg(long, value_name = "NAME")]
    pub renew: Vec<String>,
    /// How long certificates hold.
    #[arg(long, default_value_t = 825, value_parser = clap::value_parser!(i64).range(1..=3650))]
    pub days: i64,
}

/// Options of `tangent record`.
#[derive(Debug, Args)]
pub struct Record {
    /// Folder for the recording.
    #[arg(long, default_value = "recordings")]
    pub folder: PathBuf,
}

/// Options of `tangent report`.
#[derive(Debug, Args)]
pub struct Report {
    /// Recording (`.mcap`), or a folder: its newest recording.
    pub file: PathBuf,
    /// Where to write the page; beside the recording if not named.
    #[arg(long)]
    pub html: Option<PathBuf>,
    /// Write no page.
    #[arg(long)]
    pub no_html: bool,
}

/// Options of `tangent evaluate`.
#[derive(Debug, Args)]
pub struct Evaluate {
    /// A name from `scenarios/`, or a file; `list` names them.
    pub scenario: String,
    /// Estimator in place of the scenario's.
    #[arg(long)]
    pub estimator: Option<String>,
    /// Controller preset in place of the scenario's.
    #[arg(long)]
    pub controller: Option<String>,
    /// Seed in place of the scenario's.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Override one key of the scenario, `KEY.PATH=VALUE`; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// Options of `tangent reproduce`.
#[derive(Debug, Args)]
pub struct Reproduce {
    /// Which paper.
    #[arg(value_parser = ["tugal", "karacan", "lippiello", "all"])]
    pub paper: String,
    /// Seeds per row: 5 for `tugal` and 10 for `karacan`, whose figures are means over them, 20 for
    /// `lippiello`, whose figures are medians.
    #[arg(long)]
    pub seeds: Option<u64>,
    /// Also draw the paper's figures beside ours as SVG files into this folder (`karacan`,
    /// `lippiello`).
    #[arg(long, value_name = "FOLDER")]
    pub figures: Option<PathBuf>,
}

/// Options of `tangent faults`.
#[derive(Debug, Args)]
pub struct Faults {
    /// Which ones; all if none is named.
    pub faults: Vec<String>,
    /// Only name them.
    #[arg(long)]
    pub list: bool,
    /// Allowed beyond every bound, ms: what a machine that is busy with other things may take.
    #[arg(long, default_value_t = 30.0)]
    pub allow_ms: f64,
    /// Keep the logs and recordings here.
    #[arg(long)]
    pub folder: Option<PathBuf>,
    /// Added to every port of the private cell.
    #[arg(long, default_value_t = 4000)]
    pub port_offset: u16,
    /// Seed of the simulator's noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Options of `tangent doctor`.
#[derive(Debug, Args)]
pub struct Doctor {
    /// Look at this machine only, not at the cell's robot and sensor and the way to them.
    #[arg(long)]
    pub machine: bool,
}

/// Options of `tangent check`.
#[derive(Debug, Args)]
pub struct Check {
    /// Cells, tasks, scenarios, robot models, in any order. A task is checked on the cell that
    /// --cell names.
    #[arg(required = true)]
    pub files: Vec<PathBuf>,
    /// What the files are; by default that is seen from their keys.
    #[arg(long, value_enum)]
    pub kind: Option<FileKind>,
    /// Joint positions from which tasks start, rad, base to flange, commas between them; by default
    /// those of the scenario that the cell simulates. Reach and workspace are only checked from a
    /// start.
    #[arg(
        long,
        value_name = "Q1,Q2,...",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    pub start: Vec<f64>,
}

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum FileKind {
    /// A cell: robot, sensor, tool, limits, network.
    Cell,
    /// A task: force, path, estimators.
    Task,
    /// A scenario of the simulator.
    Scenario,
    /// A robot model.
    Model,
}

/// What to do with the robot.
#[derive(Clone, Copy, Debug, PartialEq, Subcommand)]
pub enum RobotCommand {
    /// Leave a protective stop (UR) or a reflex (Franka). Look for the cause first.
    Unlock {
        /// Wait so many seconds for the arm to be ready after it.
        #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = seconds)]
        wait_s: f64,
    },
    /// Send the bridge's program to the robot again, and leave a latched stop.
    Reset {
        /// Wait so many seconds for the arm to be ready after it.
        #[arg(long, value_name = "SECONDS", default_value_t = 20.0, value_parser = seconds)]
        wait_s: f64,
    },
    /// Switch the arm's power on and release the brakes.
    PowerOn {
        /// Wait so many seconds for the arm to be ready after it.
        #[arg(long, value_name = "SECONDS", default_value_t = 40.0, value_parser = seconds)]
        wait_s: f64,
    },
    /// Switch the arm's power off; the brakes close. Refused while a task runs.
    PowerOff,
    /// What the robot says of itself: mode, safety, program, and why it is not ready.
    Status,
}

/// What to do with robot models.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// Names of the built-in models.
    List,
    /// One model's data: a built-in name or a file.
    Show {
        /// Name or file.
        name: String,
    },
    /// Compare with reference values and print the largest relative differences.
    Check {
        /// Reference values (JSON).
        file: PathBuf,
        /// A model file of your own to check instead of the built-in ones; may be repeated.
        #[arg(long)]
        model: Vec<PathBuf>,
    },
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.1..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("from 0.1 to 3600".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use std::fs;
    use std::path::Path;

    #[test]
    fn the_grammar_is_sound() {
        Cli::command().debug_assert();
    }

    fn pages(folder: &Path, found: &mut Vec<std::path::PathBuf>) {
        for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let path = entry.path();
            if path.is_dir() {
                pages(&path, found);
            } else if path.extension().is_some_and(|e| e == "md") {
                found.push(path);
            }
        }
    }

    /// Every command in a fenced block of the README and the documentation is one that the program
    /// takes, and every file it names below `deploy/` and `scenarios/` exists.
    #[test]
    fn every_documented_command_is_taken() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut found = vec![root.join("README.md")];
        pages(&root.join("docs"), &mut found);
        let mut commands = 0;
        for page in found {
            let text = fs::read_to_string(&page).unwrap();
            let mut fenced = false;
            for line in text.lines() {
                if line.trim_start().starts_with("```") {
                    fenced = !fenced;
                }
                let line = line.trim_start().trim_start_matches("$ ");
                let line = line
                    .strip_prefix("cargo run --release -- ")
                    .map_or(line.to_owned(), |rest| format!("tangent {rest}"));
                if !fenced || !line.starts_with("tangent ") {
                    continue;
                }
                let words: Vec<&str> = line
                    .split(" #")
                    .next()
                    .unwrap()
                    .split(['|', '>', '&'])
                    .next()
                    .unwrap()
                    .split_whitespace()
                    .map(|word| word.trim_matches(['"', '\'']))
                    .collect();
                if let Err(error) = Cli::try_parse_from(&words) {
                    let fine = matches!(
                        error.kind(),
                        clap::error::ErrorKind::DisplayHelp
                            | clap::error::ErrorKind::DisplayVersion
                    );
                    assert!(fine, "{}: `{line}`: {error}", page.display());
                }
                for word in words {
                    if word.starts_with("deploy/") || word.starts_with("scenarios/") {
                        assert!(
                            root.join(word).exists(),
                            "{}: `{line}`: {word}",
                            page.display()
                        );
                    }
                }
                commands += 1;
            }
        }
        assert!(
            commands > 10,
            "only {commands} commands found: is the search broken?"
        );
    }

    /// Every link of the README and the documentation to a file of the repository leads somewhere.
    #[test]
    fn every_link_leads_somewhere() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut found = vec![root.join("README.md")];
        pages(&root.join("docs"), &mut found);
        for page in found {
            let text = fs::read_to_string(&page).unwrap();
            for part in text.split("](").skip(1) {
                let target = part.split([')', '#', ' ']).next().unwrap();
                if target.is_empty() || target.contains("://") {
                    continue;
                }
                let path = page.parent().unwrap().join(target);
                assert!(path.exists(), "{}: {target}", page.display());
            }
        }
    }
}
