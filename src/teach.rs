//! `tangent teach`: the arm is guided by hand, points and strokes are taken with keys, and a task
//! file is written.

use std::fs;
use std::io::{BufRead, IsTerminal, stdin};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use serde_json::json;
use tangent_check::{FileKind, OnCell, check_file};
use tangent_client::session;
use tangent_compose::model;
use tangent_mechanics::ModelData;
use tangent_runtime::config::{Law, RobotDriver};
use tangent_runtime::{Bus, CellConfig};
use tangent_teach::{
    ArmLesson, Bridge, Draft, DraftOptions, KeptGuide, Key, Pressed, Shape, Shown, TeachError,
    draft,
};

use crate::cli::Teach;
use crate::output::{Outcome, file_to_write, print_json};
use crate::table::paragraph;
use crate::terminal;

/// Interval between two looks at the arm and the keys.
const LOOK: Duration = Duration::from_millis(20);
const KEYS: &str =
    "Enter: point, s: stroke begins or ends, u: undo, h: home is here, d: done, q: quit";

/// Teaches a task and writes its file.
///
/// # Errors
/// The arm is not given to the hand, the input ends before the task is done, or the file cannot be
/// written.
pub fn run(args: &Teach, config: &CellConfig, json: bool) -> Result<Outcome> {
    let file = file_to_write(
        args.output.as_ref(),
        format!("{}.toml", args.name),
        args.force,
    )?;
    let model = model(config)?;
    let bus = session::join(config)?;
    let mut lesson = ArmLesson::open(&bus)?;
    let guide = guide(args, config, &bus)?;
    let taught = teach(args, config, &model, &mut lesson, guide.as_ref())?;
    // The arm holds itself before anything else takes time.
    drop(guide);
    let Some(draft) = taught else {
        terminal::say("nothing is written");
        return Ok(Outcome::Failed);
    };
    fs::write(&file, &draft.text).with_context(|| format!("writing {}", file.display()))?;
    report(&file, &draft, args, json)
}

/// The bridge of the cell's arm.
pub fn bridge(config: &CellConfig) -> Bridge {
    let is_franka = config.robot.driver == RobotDriver::Franka;
    Bridge {
        service: if is_franka { "franka" } else { "rtde" },
        has_own_buttons: is_franka,
    }
}

/// Where a path is shown, for a comment in its file.
pub fn shown_on(config: &CellConfig) -> String {
    format!("{} ({})", config.cell.name, config.robot.model)
}

/// Whether the cell's law moves the arm to a start pose.
pub fn travels(config: &CellConfig) -> bool {
    config.controller.law == Law::HybridAdmittance
}

/// Makes the arm free to be moved, where a program can do that.
fn guide(args: &Teach, config: &CellConfig, bus: &Bus) -> Result<Option<KeptGuide>> {
    if args.no_freedrive {
        return Ok(None);
    }
    let bridge = bridge(config);
    match KeptGuide::begin(bus, bridge.service) {
        Ok(guide) => {
            terminal::say("the arm is FREE: hold it, and move it by hand");
            Ok(Some(guide))
        }
        // The arm's own buttons are the only way there.
        Err(TeachError::NotGuided(reason)) if bridge.has_own_buttons => {
            terminal::say(&reason);
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

/// Takes keys until the task is done; `None` if it is not wanted.
fn teach(
    args: &Teach,
    config: &CellConfig,
    model: &ModelData,
    lesson: &mut ArmLesson,
    guide: Option<&KeptGuide>,
) -> Result<Option<Draft>> {
    let flange_from_tool = config.tool.flange_from_tool();
    let shown_on = shown_on(config);
    let options = DraftOptions {
        name: &args.name,
        shown_on: &shown_on,
        shape: match args.spacing_m {
            Some(spacing_m) => Shape::Region { spacing_m },
            None if args.polygon => Shape::Polygon,
            None => Shape::Open,
        },
        force_n: args.force_n,
        speed_m_per_s: args.speed,
        clearance_m: args.clearance_m,
        tolerance_m: args.tolerance_m,
        travels: travels(config),
        model,
        flange_from_tool: &flange_from_tool,
    };
    terminal::say(KEYS);
    let keys = keys();
    let shows = std::io::stderr().is_terminal();
    let bar = shows.then(|| terminal::bar(0, "{wide_msg}"));
    let taught = loop {
        lesson.look();
        if let Some(bar) = &bar {
            show(bar, lesson);
        }
        if let Some(reason) = guide.and_then(KeptGuide::take_lost) {
            terminal::say(&format!(
                "the arm is not free any more: {reason}; `d` writes what was shown"
            ));
        }
        let key = match keys.recv_timeout(LOOK) {
            Ok(Some(key)) => key,
            Ok(None) => {
                terminal::say(KEYS);
                continue;
            }
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => {
                bail!("the input ended before `d`: nothing is written")
            }
        };
        let key = match key {
            Key::Point if args.stroke => Key::Stroke,
            key => key,
        };
        let pressed = match lesson.press(key) {
            Ok(pressed) => pressed,
            Err(error) => {
                terminal::say(&format!("not taken: {error}"));
                continue;
            }
        };
        match pressed {
            Pressed::Taken(words) => terminal::say(&words),
            Pressed::Refused(words) => terminal::say(&format!("not taken: {words}")),
            Pressed::Quit => break None,
            Pressed::Done => match draft(lesson.lesson(), &options) {
                Ok(draft) => break Some(draft),
                Err(error) => terminal::say(&format!("not done: {error}")),
            },
        }
    };
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    Ok(taught)
}

/// Keys as they are pressed: single keys in a terminal, lines of other input. `None` is a key
/// without a meaning.
fn keys() -> Receiver<Option<Key>> {
    let (sender, keys) = channel();
    // It may wait for a key for ever; the process ends without it.
    std::thread::spawn(move || {
        if stdin().is_terminal() {
            let terminal = console::Term::stderr();
            while let Ok(key) = terminal.read_key() {
                let key = match key {
                    console::Key::Enter => Some(Key::Point),
                    console::Key::Char(character) => Key::of_char(character),
                    _ => None,
                };
                if sender.send(key).is_err() {
                    return;
                }
            }
            return;
        }
        for line in stdin().lock().lines() {
            let Ok(line) = line else { return };
            if sender.send(Key::of_line(&line)).is_err() {
                return;
            }
        }
    });
    keys
}

/// Shows where the tool is, and what was taken.
fn show(bar: &ProgressBar, lesson: &ArmLesson) {
    let (points, strokes) = lesson.lesson().counts();
    let place = match lesson.now() {
        Ok(now) => in_words(now),
        Err(error) => error.to_string(),
    };
    let stroke = if lesson.lesson().is_stroking() {
        ", taking a stroke"
    } else {
        ""
    };
    bar.set_message(format!(
        "{place}   {points} points, {strokes} strokes{stroke}"
    ));
}

fn in_words(now: &Shown) -> String {
    let [x, y, z] = now.base_from_tool.translation().map(|v| v * 1e3).into();
    let axis = now.base_from_tool.z_axis();
    format!(
        "tool at ({x:.1}, {y:.1}, {z:.1}) mm, pointing ({:.2}, {:.2}, {:.2})",
        axis.x, axis.y, axis.z
    )
}

/// Prints what was written, and what `tangent check` says about it.
fn report(file: &Path, draft: &Draft, args: &Teach, json: bool) -> Result<Outcome> {
    let (_, findings) = check_file(file, Some(FileKind::Task), None::<&OnCell>);
    let good = findings.errors.is_empty();
    if json {
        print_json(&json!({
            "file": file.display().to_string(),
            "good": good,
            "errors": findings.errors,
            "name": args.name,
            "places": draft.places,
            "length_m": draft.length_m,
            "start_joints_rad": draft.start_joints_rad,
            "notes": draft.notes,
        }))?;
    } else {
        println!(
            "{}: written: {} places, {:.0} mm",
            file.display(),
            draft.places,
            draft.length_m * 1e3
        );
        for error in &findings.errors {
            paragraph(2, error);
        }
        for note in &draft.notes {
            paragraph(2, &format!("note: {note}"));
        }
        println!("Next: tangent task start {} --follow", file.display());
    }
    Ok(if good {
        Outcome::Done
    } else {
        Outcome::Refused
    })
}
