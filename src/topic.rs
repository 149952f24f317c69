//! `tangent topic`: what is published on a cell's bus.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use serde_json::{Map, Value, json};
use tangent_client::session;
use tangent_client::status::no_such_cell;
use tangent_client::topics::{self, Decoded, RateMeter, TopicSeen, decode};
use tangent_runtime::bus::RawMessage;
use tangent_runtime::{Bus, CellConfig, Stop};

use crate::cli::{Echo, Hz, TopicCommand};
use crate::output::{Outcome, bad_usage, print_json};
use crate::table::Columns;

/// Longest time between two looks at Ctrl-C.
const LOOK: Duration = Duration::from_millis(100);
/// Elements of a list that are printed.
const SHOWN: usize = 16;
/// Time that `hz` waits for the first message.
const HZ_WAIT: Duration = Duration::from_secs(3);

/// Runs one of the topic commands.
///
/// # Errors
/// The cell cannot be reached, or the topic is silent.
pub fn run(command: &TopicCommand, config: &CellConfig, json: bool) -> Result<Outcome> {
    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    let bus = session::join(config)?;
    match command {
        TopicCommand::List { seconds } => {
            let seen = topics::list(&bus, Duration::from_secs_f64(*seconds), &stop)?;
            list(&seen, config, json)
        }
        TopicCommand::Echo(args) => echo(args, &bus, &stop, json),
        TopicCommand::Hz(args) => hz(args, &bus, &stop, json),
    }
}

fn list(seen: &[TopicSeen], config: &CellConfig, json: bool) -> Result<Outcome> {
    if seen.is_empty()
        && let Some(error) = no_such_cell(config)?
    {
        return Err(error.into());
    }
    if json {
        print_json(&json!({ "cell": config.cell.name, "topics": seen }))?;
    } else if seen.is_empty() {
        println!("no topic of cell {} has messages", config.cell.name);
    } else {
        let mut table = Columns::new(&["topic", "type", ">from", ">Hz", ">kB/s"]);
        for topic in seen {
            table.row([
                topic.topic.clone(),
                // The packages are in the JSON: the names alone are unique.
                topic
                    .r#type
                    .rsplit('/')
                    .next()
                    .unwrap_or_default()
                    .to_owned(),
                topic.publishers.to_string(),
                format!("{:.1}", topic.rate_hz),
                format!("{:.1}", topic.bytes_per_s * 1e-3),
            ]);
        }
        table.print(0);
    }
    Ok(if seen.is_empty() {
        Outcome::Failed
    } else {
        Outcome::Done
    })
}

fn echo(args: &Echo, bus: &Bus, stop: &Stop, json: bool) -> Result<Outcome> {
    let messages = topics::subscribe(bus, &args.topic)?;
    let patience = Duration::from_secs_f64(args.wait_s);
    let began = Instant::now();
    let mut printed = 0;
    while !stop.is_stopped() && args.count.is_none_or(|count| printed < count) {
        let Some(message) = messages.recv_timeout(LOOK) else {
            if printed == 0 && began.elapsed() >= patience {
                return Err(topics::silent(bus, &args.topic, patience)?.into());
            }
            continue;
        };
        show(&message, args, json)?;
        printed += 1;
    }
    Ok(Outcome::Done)
}

/// Prints one message: with `--json` as one line, otherwise one line per field.
fn show(message: &RawMessage, args: &Echo, json: bool) -> Result<()> {
    let mut decoded = decode(message);
    if !args.full {
        decoded = decoded.shortened(SHOWN);
    }
    let (fields, unreadable) = match decoded {
        Decoded::Fields(value) => (picked(value, &args.fields)?, None),
        Decoded::Unreadable(why) => (Value::Null, Some(why)),
    };
    if json {
        let line = json!({
            "topic": &*message.key,
            "type": message.type_name,
            "sequence": message.sequence,
            "received_ns": message.received_ns,
            "message": fields,
            "unreadable": unreadable,
        });
        println!("{line}");
        return Ok(());
    }
    println!("{} {}", message.key, message.sequence);
    if let Some(why) = unreadable {
        println!("  {why}");
    }
    print_fields(&fields, 2);
    Ok(())
}

/// The fields that are asked for, or all of them.
fn picked(message: Value, fields: &[String]) -> Result<Value> {
    if fields.is_empty() {
        return Ok(message);
    }
    let mut found = Map::new();
    for path in fields {
        let mut at = &message;
        for name in path.split('.') {
            at = at.get(name).ok_or_else(|| unknown_field(path, name, at))?;
        }
        found.insert(path.clone(), at.clone());
    }
    Ok(Value::Object(found))
}

fn unknown_field(path: &str, name: &str, at: &Value) -> anyhow::Error {
    let names: Vec<&str> = match at {
        Value::Object(fields) => fields.keys().map(String::as_str).collect(),
        _ => Vec::new(),
    };
    let meant = tangent_mechanics::names::did_you_mean(name, names.iter().copied());
    let known = if names.is_empty() {
        "it has no fields".to_owned()
    } else {
        format!("there are: {}", names.join(", "))
    };
    bad_usage(format!(
        "--fields {path}: no field `{name}`{meant}; {known}"
    ))
}

fn print_fields(value: &Value, indent: usize) {
    let Value::Object(fields) = value else {
        return;
    };
    for (name, value) in fields {
        if let Value::Object(_) = value {
            println!("{:indent$}{name}:", "");
            print_fields(value, indent + 2);
        } else {
            println!("{:indent$}{name}: {value}", "");
        }
    }
}

fn hz(args: &Hz, bus: &Bus, stop: &Stop, json: bool) -> Result<Outcome> {
    let messages = topics::subscribe(bus, &args.topic)?;
    let time = Duration::from_secs_f64(args.seconds);
    let mut meter = RateMeter::default();
    let began = Instant::now();
    let mut first: Option<Instant> = None;
    while !stop.is_stopped() && first.is_none_or(|first| first.elapsed() < time) {
        if let Some(message) = messages.recv_timeout(LOOK) {
            first.get_or_insert_with(Instant::now);
            meter.take(&message);
        } else if first.is_none() && began.elapsed() >= HZ_WAIT.max(time) {
            let waited = began.elapsed();
            return Err(topics::silent(bus, &args.topic, waited)?.into());
        }
    }
    let rate = meter.rate();
    if json {
        print_json(&json!({ "topic": args.topic, "rate": rate }))?;
        return Ok(Outcome::Done);
    }
    let number = |x: Option<f64>, digits: usize| {
        x.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
    };
    println!("{}: {} Hz", args.topic, number(rate.rate_hz, 2));
    println!(
        "  interval  median {} ms, p99 {} ms, {} to {} ms",
        number(rate.interval_median_ms, 3),
        number(rate.interval_p99_ms, 3),
        number(rate.interval_min_ms, 3),
        number(rate.interval_max_ms, 3),
    );
    println!(
        "  {} messages of {} bytes, {} lost",
        rate.messages,
        number(rate.bytes_mean, 0),
        rate.lost
    );
    Ok(Outcome::Done)
}
