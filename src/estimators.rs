//! `tangent estimator`: which estimators publish normals, how they compare, and which one is used.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use anyhow::{Result, bail};
use serde::Serialize;
use tangent_client::session;
use tangent_mechanics::names::did_you_mean;
use tangent_report::live::{EstimatorList, in_use, list_estimators, listen};
use tangent_report::run::Run as Heard;
use tangent_report::{EstimatorFigures, TaskRun, estimator_words, estimators};
use tangent_runtime::{Bus, CellConfig};
use tangent_schemas::topics::queries;

use crate::cell;
use crate::cli::{Compare, EstimatorCommand};
use crate::output::{Outcome, print_json};
use crate::report::cell_name;
use crate::table::Columns;
use crate::terminal;

/// Time to find the estimators that publish.
const LOOK: Duration = Duration::from_millis(500);

/// Runs one of the estimator commands.
///
/// # Errors
/// The cell cannot be reached, or no service in it publishes normals; or the recording cannot be
/// read.
pub fn run(
    command: &EstimatorCommand,
    cell: impl Fn() -> Result<CellConfig>,
    cell_named: Option<&Path>,
    json: bool,
) -> Result<Outcome> {
    match command {
        EstimatorCommand::List => list(&cell()?, json),
        EstimatorCommand::Use { name, force } => {
            let action = if *force { "force" } else { "select" };
            switch(&session::join(&cell()?)?, action, name, json)
        }
        EstimatorCommand::Compare(args) => match &args.file {
            Some(file) => compare_recorded(file, cell_named, json),
            None => compare_live(args, &cell()?, json),
        },
    }
}

/// Asks the controller to switch. A refusal of a name under which nobody publishes also names the
/// nearest one, and all that publish.
fn switch(bus: &Bus, action: &str, name: &str, json: bool) -> Result<Outcome> {
    let mut answer = session::ask(bus, queries::CONTROL_SELECT, action, name)?;
    if !answer.done {
        let there = bus.alive_estimators(LOOK)?;
        let mut names: Vec<&str> = there.iter().map(|(name, _)| name.as_str()).collect();
        names.dedup();
        if !names.is_empty() && !names.contains(&name) {
            let meant = did_you_mean(name, names.iter().copied());
            answer.message += &format!("{meant}; there are: {}", names.join(", "));
        }
    }
    cell::print_answer(&answer, json)?;
    Ok(if answer.done {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}

fn list(config: &CellConfig, json: bool) -> Result<Outcome> {
    let all = list_estimators(&session::join(config)?)?;
    if all.estimators.is_empty() {
        bail!(no_estimators(config));
    }
    if json {
        print_json(&all)?;
    } else {
        print(&all);
    }
    Ok(Outcome::Done)
}

fn print(list: &EstimatorList) {
    let number = |x: Option<f64>, digits: usize| {
        x.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
    };
    let mut table = Columns::new(&[
        "",
        "estimator",
        ">Hz",
        ">ms old",
        ">deg off",
        ">± deg",
        "validity",
        "on",
    ]);
    for e in &list.estimators {
        table.row([
            if e.active { "*" } else { "" }.to_owned(),
            e.name.clone(),
            number(e.rate_hz, 1),
            number(e.age_ms, 1),
            number(e.from_active_deg, 2),
            format!("{:.2}", e.std_deg),
            if e.valid { "valid" } else { &e.reason }.to_owned(),
            match e.instances.as_slice() {
                [] => "(no liveliness token)".to_owned(),
                own => own.join(", "),
            },
        ]);
    }
    table.print(0);
    println!("* in use; deg off: angle to the normal in use");
}

fn no_estimators(config: &CellConfig) -> String {
    format!(
        "no estimator publishes normals in cell {}; start `tangent run estimator`",
        config.cell.name
    )
}

#[derive(Serialize)]
struct Comparison {
    active: Option<String>,
    seconds: f64,
    estimators: BTreeMap<String, EstimatorFigures>,
}

fn compare_live(args: &Compare, config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = session::join(config)?;
    if !json {
        terminal::say(&format!("listening for {} s", args.seconds));
    }
    let heard = listen(&bus, Duration::from_secs_f64(args.seconds))?;
    if heard.estimates.is_empty() {
        bail!(no_estimators(config));
    }
    compare(&heard, args.seconds, json)
}

fn compare_recorded(file: &Path, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    let cell = cell.map(cell_name).transpose()?;
    let recorded = Heard::read(&[file.to_owned()], cell.as_deref())?;
    if recorded.estimates.is_empty() {
        bail!("{}: no estimate in this recording", file.display());
    }
    let seconds = TaskRun::of(&recorded)
        .cycles
        .last()
        .map_or(0.0, |c| c.time_s);
    compare(&recorded, seconds, json)
}

fn compare(heard: &Heard, seconds: f64, json: bool) -> Result<Outcome> {
    let comparison = Comparison {
        active: in_use(heard),
        seconds,
        estimators: estimators(heard, &TaskRun::of(heard)),
    };
    if json {
        print_json(&comparison)?;
    } else {
        let active = comparison.active.as_deref();
        print!("{}", estimator_words(&comparison.estimators, active));
    }
    Ok(Outcome::Done)
}
