//! `tangent estimator`: who publishes normals, how they compare, and which one is used.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use nalgebra::Vector3;
use serde::Serialize;
use tangent_recorder::RecordedMessage;
use tangent_runtime::{Bus, CellConfig, RawMessage, RawSubscription};
use tangent_schemas::tangent::NormalEstimate;
use tangent_schemas::topics::{self, queries};
use tangent_simulation::metrics::angle_deg;

use crate::cell;
use crate::cli::{Compare, EstimatorCommand};
use crate::output::{Outcome, print_json};
use crate::report::run::Run as Heard;
use crate::report::{EstimatorFigures, TaskRun, cell_name, estimator_words, estimators};

/// Long enough for a rate.
const LISTEN: Duration = Duration::from_millis(1500);
/// How long liveliness tokens are asked for.
const TOKENS: Duration = Duration::from_millis(500);

/// Runs one of the estimator commands.
///
/// # Errors
/// A cell that cannot be reached, or in which nobody publishes normals; a recording that cannot be
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
            let bus = cell::join(&cell()?)?;
            cell::ask_and_print(&bus, queries::CONTROL_SELECT, action, name, json)
        }
        EstimatorCommand::Compare(args) => match &args.file {
            Some(file) => compare_recorded(file, cell_named, json),
            None => compare_live(args, &cell()?, json),
        },
    }
}

#[derive(Serialize)]
struct List {
    active: Option<String>,
    estimators: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    name: String,
    active: bool,
    /// Processes that say they publish it: `HOST-PID`.
    instances: Vec<String>,
    valid: bool,
    reason: String,
    rate_hz: Option<f64>,
    /// Mean age at use, as the controller says in each of its cycles.
    age_ms: Option<f64>,
    from_active_deg: Option<f64>,
    std_deg: f64,
    friction: Option<f64>,
    update_us: f64,
}

fn list(config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = cell::join(config)?;
    let heard = listen(&bus, LISTEN)?;
    let mut instances: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (name, instance) in bus.alive_estimators(TOKENS)? {
        instances.entry(name).or_default().push(instance);
    }
    let task = TaskRun::of(&heard);
    let figures = estimators(&heard, &task);
    let active = in_use(&heard);
    let newest = |name: &String| heard.estimates.get(name).and_then(|all| all.last());
    let reference = active.as_ref().and_then(newest).map(normal);
    let mut rows: Vec<Row> = figures
        .iter()
        .filter_map(|(name, figures)| {
            let own = instances.remove(name).unwrap_or_default();
            let row = row(newest(name)?, figures, reference, own);
            Some(Row {
                active: active.as_ref() == Some(name),
                ..row
            })
        })
        .collect();
    rows.extend(instances.into_iter().map(|(name, own)| silent(name, own)));
    if rows.is_empty() {
        bail!(nobody(config));
    }
    let all = List {
        active,
        estimators: rows,
    };
    if json {
        print_json(&all)?;
    } else {
        print(&all);
    }
    Ok(Outcome::Done)
}

fn row(
    newest: &NormalEstimate,
    figures: &EstimatorFigures,
    reference: Option<Vector3<f64>>,
    instances: Vec<String>,
) -> Row {
    let c = &newest.covariance;
    Row {
        name: newest.estimator.to_string(),
        active: false,
        instances,
        valid: newest.validity == 0,
        reason: newest.reason.to_string(),
        rate_hz: figures.rate_hz,
        age_ms: figures.age_ms.map(|age| age.mean),
        from_active_deg: reference.map(|reference| angle_deg(&reference, &normal(newest))),
        std_deg: (0.5 * (c[0] + c[4] + c[8])).sqrt().to_degrees(),
        friction: (newest.friction >= 0.0).then_some(newest.friction),
        update_us: newest.update_s * 1e6,
    }
}

/// One whose process is connected but says nothing.
fn silent(name: String, instances: Vec<String>) -> Row {
    Row {
        name,
        active: false,
        instances,
        valid: false,
        reason: "connected, but publishes nothing".to_owned(),
        rate_hz: None,
        age_ms: None,
        from_active_deg: None,
        std_deg: 0.0,
        friction: None,
        update_us: 0.0,
    }
}

fn print(list: &List) {
    let number = |x: Option<f64>, digits: usize| {
        x.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
    };
    for e in &list.estimators {
        println!(
            "{} {:<24} {:>7} Hz  {:>6} ms old  {:>6} deg from the active  ±{:.2} deg  {}  {}",
            if e.active { "*" } else { " " },
            e.name,
            number(e.rate_hz, 1),
            number(e.age_ms, 1),
            number(e.from_active_deg, 2),
            e.std_deg,
            if e.valid { "valid" } else { &e.reason },
            match e.instances.as_slice() {
                [] => "(no liveliness token)".to_owned(),
                own => format!("on {}", own.join(", ")),
            },
        );
    }
}

fn normal(m: &NormalEstimate) -> Vector3<f64> {
    Vector3::from(&m.normal)
}

fn in_use(heard: &Heard) -> Option<String> {
    let name = heard.control.last()?.estimator.to_string();
    (!name.is_empty()).then_some(name)
}

fn nobody(config: &CellConfig) -> String {
    format!(
        "nobody publishes normals in cell {}; start `tangent run estimator`",
        config.cell.name
    )
}

/// How long the controller's first word is waited for.
const FIRST_WORD: Duration = Duration::from_secs(3);

#[derive(Serialize)]
struct Comparison {
    active: Option<String>,
    seconds: f64,
    estimators: BTreeMap<String, EstimatorFigures>,
}

fn compare_live(args: &Compare, config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = cell::join(config)?;
    if !json {
        eprintln!("listening for {} s", args.seconds);
    }
    let heard = listen(&bus, Duration::from_secs_f64(args.seconds))?;
    if heard.estimates.is_empty() {
        bail!(nobody(config));
    }
    compare(&heard, args.seconds, json)
}

fn compare_recorded(file: &Path, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    let cell = cell.map(cell_name).transpose()?;
    let recorded = Heard::read(&[file.to_owned()], cell.as_deref())?;
    if recorded.estimates.is_empty() {
        bail!("{}: no estimate is in it", file.display());
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

/// What the cell says about normals for so long from the controller's first word on, in the order
/// in which it came.
fn listen(bus: &Bus, time: Duration) -> Result<Heard> {
    let keys = [
        topics::ARM_STATE.key(),
        topics::CONTROL_STATE.key(),
        topics::ESTIMATE_NORMALS.key(),
        topics::TRUTH_CONTACT.key(),
    ];
    let readers: Vec<RawSubscription> = keys
        .iter()
        .map(|key| bus.subscribe_raw(key, 4096))
        .collect::<Result<_, _>>()?;
    let mut messages: Vec<RawMessage> = Vec::new();
    // Those who publish hear of a new reader one by one, and not at once.
    let give_up = Instant::now() + FIRST_WORD;
    let mut until = None;
    while let Some(left) = until
        .unwrap_or(give_up)
        .checked_duration_since(Instant::now())
    {
        // The arm's state comes with every cycle; the others are taken along with it.
        let first = readers[0].recv_timeout(left.min(Duration::from_millis(50)));
        messages.extend(first);
        for reader in &readers {
            messages.extend(std::iter::from_fn(|| reader.try_recv()));
        }
        let spoken = |key: &str| messages.iter().any(|message| &*message.key == key);
        if until.is_none() && spoken(topics::CONTROL_STATE.key()) && spoken(topics::ARM_STATE.key())
        {
            until = Some(Instant::now() + time);
        }
    }
    messages.sort_by_key(|message| message.received);
    let messages: Vec<RecordedMessage> = messages.into_iter().map(recorded).collect();
    Ok(Heard::heard(&messages))
}

fn recorded(message: RawMessage) -> RecordedMessage {
    RecordedMessage {
        topic: format!("/{}", message.key),
        type_name: message.type_name.into_owned(),
        log_time_ns: u64::try_from(message.received_ns).unwrap_or(0),
        publish_time_ns: u64::try_from(message.source_time_ns).unwrap_or(0),
        publisher: message.publisher,
        sequence: message.sequence as u32,
        bytes: message.payload.to_vec(),
    }
}
