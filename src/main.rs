//! The `tangent` command: a thin layer over the crates.

mod bench;
mod calibrate;
mod cell;
mod check;
mod cli;
mod control;
mod doctor;
mod estimators;
mod evaluate;
mod faults;
mod health;
mod keys;
mod live_view;
mod model;
mod output;
mod report;
mod reproduce;
mod robot;
mod run;
mod status;
mod suite;
mod up;

use std::process::ExitCode;
use std::time::Duration;

use anyhow::Result;
use clap::Parser;
use tangent_runtime::ending;
use tangent_runtime::log::{self, Log};
use tracing_subscriber::EnvFilter;

use cli::{CalibrateCommand, Cli, Command};
use output::Outcome;

fn main() -> ExitCode {
    ending::on_panic();
    output::end_with_the_reader();
    let log = match Log::start(std::io::stderr()) {
        Ok(log) => log,
        Err(error) => {
            eprintln!("tangent: starting the log's thread: {error}");
            return ExitCode::FAILURE;
        }
    };
    log.install();
    let cli = Cli::parse();
    let filter = EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| EnvFilter::new("info,zenoh=warn,zenoh_transport=warn,zenoh_link=warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_target(false)
        .with_writer(move || log.writer())
        .init();
    let ended = dispatch(&cli);
    let code = match (&ended, ending::cause()) {
        (_, Some(cause)) => {
            log::line(&format!("tangent: {cause}"));
            1
        }
        (Ok(outcome), None) => *outcome as u8,
        (Err(error), None) => {
            log::line(&format!("tangent: {error:#}"));
            if output::is_usage(error) { 2 } else { 1 }
        }
    };
    log::flush(LAST_WORDS);
    ExitCode::from(code)
}

/// Time allowed to write the log at the end: its reader may be blocked.
const LAST_WORDS: Duration = Duration::from_secs(2);

fn dispatch(cli: &Cli) -> Result<Outcome> {
    let json = cli.json;
    let config = || cell::load(cli.cell.as_deref(), cli.identity.as_deref());
    match &cli.command {
        Command::Up(args) => up::run(args, config()?, cli.cell.as_deref(), json),
        Command::Check(args) => check::run(args, cli.cell.as_deref(), json),
        Command::Robot(command) => robot::run(command, &config()?, json),
        Command::Run(args) => run::run(args, &config()?),
        Command::Task(command) => control::task(command, &config()?, json),
        Command::Estimator(command) => estimators::run(command, config, cli.cell.as_deref(), json),
        Command::Tare { clear } => control::tare(*clear, &config()?, json),
        Command::Calibrate(CalibrateCommand::Payload(args)) => {
            calibrate::payload(args, &config()?, json)
        }
        Command::Param(command) => control::param(command, &config()?, json),
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
    }
}
