//! `tangent cell new`: asks for model, sensor and addresses, and writes a checked cell file.

use std::io::{self, BufRead};
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::json;
use tangent_mechanics::ModelData;
use tangent_new_cell::{NewCell, Ranges, Sensor, SensorKind, kinds_of, ranges_of, write};

use crate::cli::{CellCommand, NewCell as Args, NewSensor};
use crate::output::{Outcome, bad_usage, print_json};
use crate::table::paragraph;
use crate::terminal;

/// Runs one of the cell commands.
///
/// # Errors
/// An answer is missing or refused, or the file cannot be written.
pub fn run(command: &CellCommand, json: bool) -> Result<Outcome> {
    let CellCommand::New(args) = command;
    let cell = answers(args, &mut io::stdin().lock())?;
    let named = || PathBuf::from(format!("{}.toml", cell.name));
    let file = args.file.clone().unwrap_or_else(named);
    let notes = write(&file, &cell, args.force)?;
    let shown = file.display();
    if json {
        print_json(&json!({ "file": shown.to_string(), "good": true, "notes": notes }))?;
        return Ok(Outcome::Done);
    }
    println!("{shown}: written, and checked");
    for note in &notes {
        paragraph(2, &format!("note: {note}"));
    }
    println!("Next:");
    println!("  measure what is marked \"set\" in {shown}");
    println!("  tangent doctor --cell {shown}");
    println!("  tangent up --cell {shown}    # against the simulator");
    Ok(Outcome::Done)
}

/// The cell from the options, and from answers for what they leave out.
fn answers(args: &Args, input: &mut dyn BufRead) -> Result<NewCell> {
    let mut ask = Questions {
        input,
        asks: !args.yes,
    };
    let name = ask.text(
        "--name",
        "name of the cell",
        args.name.as_deref(),
        Some("cell1"),
    )?;
    let model = model(args, &mut ask)?;
    let robot_address = ask.text(
        "--robot-address",
        "address of the robot's controller",
        args.robot_address.as_deref(),
        None,
    )?;
    let sensor = sensor(args, &model, &mut ask)?;
    Ok(NewCell {
        name,
        model,
        robot_address,
        sensor,
    })
}

/// The arm: asked again until it is one that is built in.
fn model(args: &Args, ask: &mut Questions<'_>) -> Result<String> {
    let names: Vec<&str> = ModelData::builtin_names().collect();
    let question = format!("model of the arm ({})", names.join(", "));
    loop {
        let model = ask.text("--model", &question, args.model.as_deref(), None)?;
        match kinds_of(&model) {
            Ok(_) => return Ok(model),
            Err(error) if ask.asks && args.model.is_none() => terminal::say(&error.to_string()),
            Err(error) => return Err(error.into()),
        }
    }
}

fn sensor(args: &Args, model: &str, ask: &mut Questions<'_>) -> Result<Sensor> {
    let kinds = kinds_of(model)?;
    let kind = match (args.sensor, kinds) {
        (Some(given), _) => kind_of(given),
        (None, [only]) => *only,
        (None, several) => chosen(several, ask)?,
    };
    Ok(match kind {
        SensorKind::Netft => Sensor::Netft {
            address: ask.text(
                "--sensor-address",
                "address of the Net F/T box",
                args.sensor_address.as_deref(),
                Some("192.168.1.1"),
            )?,
        },
        SensorKind::Ur => Sensor::Ur {
            ranges: range(args, ranges_of(model), ask)?,
        },
        SensorKind::Topic => Sensor::Topic {
            key: ask.text(
                "--sensor-topic",
                "topic of the sensor, relative to the cell",
                args.sensor_topic.as_deref(),
                Some("my_sensor/wrench"),
            )?,
            rate_hz: match args.sensor_rate_hz {
                Some(given) => given,
                None => number(&ask.text(
                    "--sensor-rate-hz",
                    "messages per second on that topic",
                    None,
                    None,
                )?)?,
            },
            ranges: range(args, None, ask)?,
        },
        SensorKind::Joints => Sensor::Joints,
    })
}

/// The kind of sensor: asked again until it is one of those that fit the arm.
fn chosen(kinds: &[SensorKind], ask: &mut Questions<'_>) -> Result<SensorKind> {
    let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
    let question = format!("sensor ({})", names.join(", "));
    loop {
        let answer = ask.text("--sensor", &question, None, names.first().copied())?;
        if let Some(kind) = kinds.iter().find(|kind| kind.name() == answer) {
            return Ok(*kind);
        }
        terminal::say(&format!("\"{answer}\": one of {}", names.join(", ")));
    }
}

fn kind_of(sensor: NewSensor) -> SensorKind {
    match sensor {
        NewSensor::Netft => SensorKind::Netft,
        NewSensor::Ur => SensorKind::Ur,
        NewSensor::Topic => SensorKind::Topic,
        NewSensor::Joints => SensorKind::Joints,
    }
}

fn range(args: &Args, known: Option<Ranges>, ask: &mut Questions<'_>) -> Result<Ranges> {
    if let Some((force_n, torque_nm)) = args.sensor_range {
        return Ok(Ranges { force_n, torque_nm });
    }
    if let Some(known) = known {
        return Ok(known);
    }
    let mut value = |what: &str| -> Result<f64> {
        let question = format!("{what} beyond which the sensor saturates, from its data sheet");
        number(&ask.text("--sensor-range", &question, None, None)?)
    };
    Ok(Ranges {
        force_n: value("force in N")?,
        torque_nm: value("torque in Nm")?,
    })
}

fn number(text: &str) -> Result<f64> {
    text.parse()
        .map_err(|_| bad_usage(format!("\"{text}\" is not a number")))
}

/// Questions on standard error, answered line by line.
struct Questions<'a> {
    input: &'a mut dyn BufRead,
    asks: bool,
}

impl Questions<'_> {
    /// The value of an option, or the answer to a question; an empty answer is the default.
    fn text(
        &mut self,
        option: &str,
        question: &str,
        given: Option<&str>,
        default: Option<&str>,
    ) -> Result<String> {
        if let Some(given) = given {
            return Ok(given.to_owned());
        }
        if !self.asks {
            return default
                .map(str::to_owned)
                .with_context(|| format!("{option} is missing"))
                .map_err(bad_usage);
        }
        loop {
            let shown = default.map_or_else(String::new, |default| format!(" [{default}]"));
            terminal::say(&format!("{question}{shown}:"));
            let mut line = String::new();
            if self
                .input
                .read_line(&mut line)
                .context("reading the answer")?
                == 0
            {
                return Err(bad_usage(format!(
                    "the input ended before this answer; give {option}"
                )));
            }
            match (line.trim(), default) {
                ("", Some(default)) => return Ok(default.to_owned()),
                ("", None) => {}
                (answer, _) => return Ok(answer.to_owned()),
            }
        }
    }
}
