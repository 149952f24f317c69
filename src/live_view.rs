//! Display of a task that is followed: one line that is updated in a terminal, plain lines
//! elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use tangent_control::Verdict;
use tangent_follow::{Ended, FollowError, FollowView, Start};
use tangent_runtime::{Bus, Stop};
use tangent_schemas::tangent::{ContactTruth, ControlState};

use crate::terminal;

/// Follows a task to its end, shown on standard error. With `stay`, the end is when `stop` is
/// triggered.
///
/// # Errors
/// The task is not started, or its end is not seen.
pub fn follow(bus: &Bus, start: &Start, stop: &Stop, stay: bool) -> Result<Ended, FollowError> {
    let mut view = LiveView::new();
    let ended = tangent_follow::follow(bus, start, stop, stay, &mut view);
    view.end();
    let ended = ended?;
    let percent = 100.0 * ended.progress;
    match ended.verdict() {
        Some(Verdict::Completed) => terminal::say("the task is completed"),
        Some(Verdict::Faulted) => terminal::say(&format!(
            "the task FAILED at {percent:.0} % of the path with a fault: {}",
            ended.fault
        )),
        _ => terminal::say(&format!(
            "the task is NOT completed: stopped at {percent:.0} % of the path"
        )),
    }
    Ok(ended)
}

/// Prints why a task is not started yet.
pub fn waiting(reason: &str) {
    terminal::say(&format!("waiting: {reason}"));
}

/// Shows the cell's state as it changes.
struct LiveView {
    bar: Option<ProgressBar>,
    phase: String,
    printed: Option<Instant>,
}

/// Age beyond which `control/state` does not describe the present state.
const OLD: Duration = Duration::from_millis(500);
/// Age of an input from which it is shown, s.
const SHOWN_AGE_S: f64 = 0.02;
/// Plain lines come this often.
const PLAIN_EVERY: Duration = Duration::from_secs(1);

impl LiveView {
    fn new() -> Self {
        let bar = std::io::stderr()
            .is_terminal()
            .then(|| terminal::bar(1000, "{prefix:>9} {bar:12} {percent:>3} % {wide_msg}"));
        Self {
            bar,
            phase: String::new(),
            printed: None,
        }
    }

    /// Clears the live line.
    fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

impl FollowView for LiveView {
    fn waiting(&mut self, reason: &str) {
        waiting(reason);
    }

    /// Prints above the live line.
    fn say(&mut self, text: &str) {
        terminal::say(text);
    }

    /// Draws or prints what is new.
    fn show(&mut self, control: &ControlState, age: Duration, truth: Option<&ContactTruth>) {
        let text = if age > OLD {
            format!("no control/state for {:.1} s", age.as_secs_f64())
        } else {
            describe(control, truth)
        };
        let changed = self.phase != control.phase_text.as_str();
        if changed {
            self.phase = control.phase_text.to_string();
        }
        match &self.bar {
            Some(bar) => {
                bar.set_prefix(self.phase.clone());
                bar.set_position((control.path_progress * 1000.0) as u64);
                bar.set_message(text);
            }
            None => {
                let due = self.printed.is_none_or(|at| at.elapsed() >= PLAIN_EVERY);
                if changed || due {
                    self.printed = Some(Instant::now());
                    terminal::say(&format!(
                        "{:>9} {:3.0} % {text}",
                        self.phase,
                        control.path_progress * 100.0
                    ));
                }
            }
        }
    }
}

/// The pressing force in words, without a number while no wrench can be used.
fn shown_force(control: &ControlState) -> String {
    if control.force_n.is_finite() {
        format!("{:.2}", control.force_n)
    } else {
        "?".to_owned()
    }
}

/// The state in one line that fits a terminal of 80 columns beside phase and bar, unless there is a
/// fault.
fn describe(control: &ControlState, truth: Option<&ContactTruth>) -> String {
    let mut text = format!(
        "{} of {:.1} N, tool {:.1}°, path {:.1} mm",
        shown_force(control),
        control.force_reference_n,
        control.alignment_error_rad.to_degrees(),
        control.path_error_m * 1e3,
    );
    if let Some(truth) = truth.filter(|t| t.in_contact) {
        let error_deg = true_error_deg(control, truth);
        text.push_str(&format!(", normal {error_deg:.1}°"));
    }
    for (what, age_s) in [
        ("wrench", control.wrench_age_s),
        ("normal", control.estimate_age_s),
    ] {
        if age_s > SHOWN_AGE_S {
            text.push_str(&format!(", {what} {:.0} ms old", age_s * 1e3));
        }
    }
    if !control.fault.is_empty() {
        text.push_str(&format!("  FAULT: {}", control.fault));
    }
    text
}

fn true_error_deg(control: &ControlState, truth: &ContactTruth) -> f64 {
    let a = nalgebra::Vector3::new(control.normal.x, control.normal.y, control.normal.z);
    let b = nalgebra::Vector3::new(truth.normal.x, truth.normal.y, truth.normal.z);
    a.cross(&b).norm().atan2(a.dot(&b)).to_degrees()
}
