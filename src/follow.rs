//! One task from its start to its end: waits until the cell is ready, starts it, shows it, retracts
//! when asked to stop.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use tangent_control::preflight::REFUSED;
use tangent_control::{Phase, Task};
use tangent_runtime::{Bus, Latest, Stop};
use tangent_schemas::tangent::{ArmState, WrenchStatus};
use tangent_schemas::topics::{self, queries};

use crate::cell::{ask, data};
use crate::live_view::LiveView;
use crate::output::bad_usage;

/// Longest wait for the retract after Ctrl-C.
const RETRACT_PATIENCE: Duration = Duration::from_secs(20);
/// A controller that says nothing for this long is gone: long enough for a router or a container
/// that restarts.
const SILENCE: Duration = Duration::from_secs(30);
/// How often the view is renewed.
const LOOK: Duration = Duration::from_millis(50);
/// Between two attempts to start a task that is refused because something is not there yet.
const RETRY: Duration = Duration::from_millis(500);

/// Starts `task` (TOML) with `action` (`start`, or `start_clear`) when everything is ready, shows
/// it, and waits for its end: the phase it ended in, and the fault, empty when there is none. With
/// `stay`, that is when `stop` is triggered. A `stop` before the end retracts.
///
/// # Errors
/// The cell is not ready, or refuses the task, for longer than `patience`; the arm does not
/// retract; the controller is gone.
pub fn follow(
    bus: &Bus,
    action: &str,
    task: &str,
    stop: &Stop,
    patience: Duration,
    stay: bool,
) -> Result<(Phase, String)> {
    let mut view = LiveView::new(bus)?;
    view.say(&start_when_ready(bus, action, task, stop, patience)?);
    let mut asked_to_stop: Option<Instant> = None;
    let mut seen_active = false;
    let started = Instant::now();
    let phase = loop {
        view.refresh();
        let phase = view.control().and_then(|c| Phase::from_code(c.phase));
        if let Some(phase) = phase {
            seen_active |= phase.is_active();
            if seen_active && !phase.is_active() && (!stay || stop.is_stopped()) {
                break phase;
            }
        }
        if view.silence().unwrap_or_else(|| started.elapsed()) > SILENCE {
            view.end();
            bail!("the controller has said nothing for {SILENCE:?}: see `tangent status`");
        }
        if stop.is_stopped() {
            let since = *asked_to_stop.get_or_insert_with(|| {
                view.say("retracting");
                if let Err(error) = ask(bus, queries::CONTROL_STOP, "stop", "") {
                    view.say(&format!("{error:#}"));
                }
                Instant::now()
            });
            if since.elapsed() > RETRACT_PATIENCE {
                view.end();
                bail!("the arm did not retract within {RETRACT_PATIENCE:?}");
            }
            std::thread::sleep(LOOK);
        } else {
            stop.wait(LOOK);
        }
    };
    view.refresh();
    view.end();
    let fault = match view.control() {
        Some(control) if phase == Phase::Fault => control.fault.to_string(),
        _ => String::new(),
    };
    if !fault.is_empty() {
        eprintln!("the task ended with a fault: {fault}");
    }
    Ok((phase, fault))
}

/// Starts `task` (TOML) as soon as everything is ready, and returns what the controller says.
///
/// # Errors
/// The cell is not ready, or refuses the task, for longer than `patience`.
pub fn start_when_ready(
    bus: &Bus,
    action: &str,
    task: &str,
    stop: &Stop,
    patience: Duration,
) -> Result<String> {
    let until = Instant::now() + patience;
    wait_until_ready(bus, stop, until)?;
    start(bus, action, task, stop, until)
}

/// Asks for the start until it is granted: a controller or an estimator may still be on its way.
fn start(bus: &Bus, action: &str, task: &str, stop: &Stop, until: Instant) -> Result<String> {
    let mut said = String::new();
    let mut unknown = false;
    loop {
        let reason = match ask(bus, queries::CONTROL_TASK, action, task) {
            Ok(answer) if answer.done => return Ok(answer.message),
            // An answer before this one may have been lost on its way.
            Ok(_) if unknown && runs(bus, task) => {
                return Ok("the task runs; the answer to its start was lost".to_owned());
            }
            Ok(answer) if answer.message.starts_with(REFUSED) => {
                return Err(bad_usage(format!("task: {}", answer.message)));
            }
            Ok(answer) => answer.message,
            Err(error) => {
                unknown = true;
                format!("{error:#}")
            }
        };
        if Instant::now() >= until {
            bail!("the controller does not start the task: {reason}");
        }
        if reason != said {
            eprintln!("waiting: {reason}");
            said = reason;
        }
        if stop.wait(RETRY) {
            bail!("stopped before the task began");
        }
    }
}

/// The controller says that a task of this name is under way.
fn runs(bus: &Bus, task: &str) -> bool {
    let (Ok(task), Ok(answer)) = (
        task.parse::<Task>(),
        ask(bus, queries::CONTROL_TASK, "status", ""),
    ) else {
        return false;
    };
    let status = data(&answer);
    let phase = |phase: Phase| status["phase"] == phase.name();
    status["task"] == task.name.as_str()
        && Phase::ALL.into_iter().any(|p| p.is_active() && phase(p))
}

fn wait_until_ready(bus: &Bus, stop: &Stop, until: Instant) -> Result<()> {
    let mut arm: Latest<ArmState> = bus.latest(&topics::ARM_STATE)?;
    let mut sensor: Latest<WrenchStatus> = bus.latest(&topics::WRENCH_STATUS)?;
    let began = Instant::now();
    let mut said = String::new();
    loop {
        let arm_waits = match arm.get() {
            None => Some("no packet from the robot yet".to_owned()),
            Some(r) if r.message.ready => None,
            Some(r) => Some(r.message.not_ready_reason.to_string()),
        };
        let sensor_waits = match sensor.get() {
            None => Some("no record from the sensor yet".to_owned()),
            Some(r) if r.message.validity == 0 => None,
            Some(r) => Some(r.message.status_text.to_string()),
        };
        let waits: Vec<String> = arm_waits
            .map(|w| format!("robot: {w}"))
            .into_iter()
            .chain(sensor_waits.map(|w| format!("sensor: {w}")))
            .collect();
        if waits.is_empty() {
            return Ok(());
        }
        let waits = waits.join("; ");
        if waits != said {
            eprintln!("waiting: {waits}");
            said = waits;
        }
        if Instant::now() >= until {
            bail!("not ready after {:.0?}: {said}", began.elapsed());
        }
        if stop.wait(LOOK) {
            bail!("stopped before the task began");
        }
    }
}
