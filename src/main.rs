//! The `tangent` command: a thin layer over the crates.

mod bench;
mod calibrate;
mod cell;
mod check;
mod cli;
mod completions;
mod control;
mod doctor;
mod estimators;
mod evaluate;
mod failure;
mod faults;
mod health;
mod keys;
mod live_view;
mod model;
mod new_cell;
mod output;
mod page_teacher;
mod region;
mod report;
mod reproduce;
mod robot;
mod run;
mod scan;
mod status;
mod suite;
mod table;
mod task_file;
mod teach;
mod terminal;
mod topic;
mod ui;
mod up;

use std::process::ExitCode;
use std::time::Duration;

use anyhow::Result;
use clap::Parser;
use tangent_client::ClientError;
use tangent_client::status::no_such_cell;
use tangent_runtime::log::{self, Log};
use tangent_runtime::{CellConfig, ending};
use tracing_subscriber::EnvFilter;

use cli::{CalibrateCommand, Cli, Command};
use output::Outcome;

fn main() -> ExitCode {
    ending::on_panic();
    output::end_with_the_reader();
    let log = match Log::start(terminal::LogSink::new()) {
        Ok(log) => log,
        Err(error) => {
            eprintln!("tangent: starting the log's thread: {error}");
            return ExitCode::FAILURE;
        }
    };
    log.install();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return failure::of_grammar(error),
    };
    let filter = EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| EnvFilter::new("info,zenoh=warn,zenoh_transport=warn,zenoh_link=warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_target(false)
        .with_ansi(terminal::has_colours())
        .with_writer(move || log.writer())
        .init();
    let ended = dispatch(&cli).map_err(|error| in_which_cell(&cli, error));
    let code = match (&ended, ending::cause()) {
        (_, Some(cause)) => {
            failure::tell(cause, 1, cli.json);
            1
        }
        (Ok(outcome), None) => *outcome as u8,
        (Err(error), None) => {
            let code = if output::is_usage(error) { 2 } else { 1 };
            failure::tell(&format!("{error:#}"), code, cli.json);
            code
        }
    };
    log::flush(LAST_WORDS);
    ExitCode::from(code)
}

/// For a command that has failed in a cell without services: the names of the cells that have some.
fn in_which_cell(cli: &Cli, error: anyhow::Error) -> anyhow::Error {
    let is_about_the_cell = cli.command.asks_a_cell()
        && !output::is_usage(&error)
        && !matches!(
            error.downcast_ref::<ClientError>(),
            Some(ClientError::Unreachable { .. } | ClientError::NoSuchCell { .. })
        );
    if !is_about_the_cell {
        return error;
    }
    match config_of(cli).map(|config| no_such_cell(&config)) {
        Ok(Ok(Some(wrong))) => wrong.into(),
        _ => error,
    }
}

/// The cell that the command is about.
fn config_of(cli: &Cli) -> Result<CellConfig> {
    let mut config = cell::load(cli.cell.as_deref(), cli.identity.as_deref())?;
    cell::connect(&mut config, &cli.connect)?;
    Ok(config)
}

/// Time allowed to write the log at the end: its reader may be blocked.
const LAST_WORDS: Duration = Duration::from_secs(2);

fn dispatch(cli: &Cli) -> Result<Outcome> {
    let json = cli.json;
    if !cli.connect.is_empty() && !cli.command.talks_to_a_cell() {
        return Err(output::bad_usage(
            "--connect: this command does not talk to a running cell; leave the option out",
        ));
    }
    let config = || config_of(cli);
    match &cli.command {
        Command::Up(args) => up::run(args, config()?, cli.cell.as_deref(), json),
        Command::Cell(command) => new_cell::run(command, json),
        Command::Check(args) => check::run(args, cli.cell.as_deref(), json),
        Command::Robot(command) => robot::run(command, &config()?, json),
        Command::Run(args) => run::run(args, &config()?),
        Command::Task(command) => control::task(command, &config()?, json),
        Command::Estimator(command) => estimators::run(command, config, cli.cell.as_deref(), json),
        Command::Tare { clear } => control::tare(*clear, &config()?, json),
        Command::Calibrate(CalibrateCommand::Payload(args)) => {
            calibrate::payload(args, &config()?, json)
        }
        Command::Teach(args) => teach::run(args, &config()?, json),
        Command::Scan(args) => scan::run(args, &config()?, json),
        Command::Region(args) => region::run(args, &config()?, json),
        Command::Param(command) => control::param(command, &config()?, json),
        Command::Ui(args) => ui::run(args, config()?, json),
        Command::Topic(command) => topic::run(command, &config()?, json),
        Command::Status(args) => status::run(args, &config()?, json),
        Command::Keys(command) => keys::run(command, cli.cell.as_deref(), json),
        Command::Health(args) => health::run(args, &config()?, json),
        Command::Record(args) => run::record(args, &config()?),
        Command::Report(args) => report::run(args, cli.cell.as_deref(), json),
        Command::Evaluate(args) => match &args.scenario {
            Some(scenario) => evaluate::run(scenario, args, json),
            None => suite::run(args, json),
        },
        Command::Reproduce(args) => reproduce::run(args, json),
        Command::Faults(args) => faults::run(args, json),
        Command::Doctor(args) => doctor::run(args, &config()?, json),
        Command::Model(command) => model::run(command, json),
        Command::Bench(command) => bench::run(command, json),
        Command::Completions(args) => completions::run(args),
    }
}
