//! What happened to a task besides its path: pauses, searches for a lost surface, tares.

use serde::Serialize;
use tangent_control::{Phase, Verdict};

use crate::shown_time::shown_s;
use crate::task_run::{Cycle, TaskRun};

/// Part of a task, by time since its start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Period {
    /// Beginning, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
}

/// End and interruptions of a task.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Events {
    /// How the task ended; null without a task. Only `completed` is a success.
    pub verdict: Option<Verdict>,
    /// Share of the path that was followed, 0 to 1; null without a task.
    pub progress: Option<f64>,
    /// Times in which the task was paused.
    pub pauses: Vec<Period>,
    /// Times in which contact was lost and the tool moved towards the surface again.
    pub seeks: Vec<Period>,
    /// Times in which the arm stood still while the sensor's zero was measured.
    pub tares: Vec<Period>,
}

impl Events {
    /// Events of the last task of a recording.
    pub fn of(task: &TaskRun<'_>) -> Self {
        let Some(last) = task.cycles.last() else {
            return Self::default();
        };
        // The landing after a way above the surface is no search for a lost one.
        let mut lands = false;
        let mut seeks = |cycle: &Cycle<'_>| {
            let phase = cycle.sample.phase;
            lands = phase == Phase::Lift || lands && phase == Phase::Seek;
            phase == Phase::Seek && !lands
        };
        // A controller that holds the arm after the end reports no progress any more.
        let progress = task
            .cycles
            .iter()
            .map(|cycle| cycle.control.path_progress)
            .fold(0.0, f64::max);
        Self {
            verdict: Verdict::of(last.sample.phase, progress),
            progress: Some(progress),
            pauses: periods(task, |cycle| cycle.control.paused),
            seeks: periods(task, &mut seeks),
            tares: periods(task, |cycle| cycle.sample.phase == Phase::Tare),
        }
    }

    /// The verdict in a sentence: `stopped at 43 % of the path`.
    pub fn verdict_words(&self, fault: Option<&str>) -> String {
        let percent = 100.0 * self.progress.unwrap_or_default();
        match self.verdict {
            None => "no task".to_owned(),
            Some(Verdict::Completed) => "completed: the whole path was followed".to_owned(),
            Some(Verdict::Stopped) => {
                format!("NOT COMPLETED: stopped at {percent:.0} % of the path")
            }
            Some(Verdict::Faulted) => format!(
                "FAILED: faulted at {percent:.0} % of the path{}",
                fault.map_or_else(String::new, |fault| format!(": {fault}"))
            ),
            Some(Verdict::Unfinished) => format!(
                "NOT COMPLETED: the recording ends within the task, at {percent:.0} % of the path"
            ),
        }
    }

    /// Each kind of interruption that occurred: its name, and the times in words.
    pub fn interruptions(&self) -> Vec<(&'static str, String)> {
        [
            ("pauses", &self.pauses),
            ("seeks", &self.seeks),
            ("tares", &self.tares),
        ]
        .into_iter()
        .filter(|(_, periods)| !periods.is_empty())
        .map(|(name, periods)| (name, times(periods)))
        .collect()
    }
}

/// Periods of consecutive cycles for which `holds`.
fn periods(task: &TaskRun<'_>, mut holds: impl FnMut(&Cycle<'_>) -> bool) -> Vec<Period> {
    let mut found: Vec<Period> = Vec::new();
    let mut open = false;
    for cycle in &task.cycles {
        let now = holds(cycle);
        match found.last_mut() {
            Some(period) if open => period.to_s = cycle.time_s,
            _ if now => found.push(Period {
                from_s: cycle.time_s,
                to_s: cycle.time_s,
            }),
            _ => {}
        }
        open = now;
    }
    found
}

/// Most periods that are listed one by one.
const LISTED: usize = 4;

/// Number of periods, their sum, and the first of them.
fn times(periods: &[Period]) -> String {
    let total: f64 = periods.iter().map(|p| p.to_s - p.from_s).sum();
    let each: Vec<String> = periods
        .iter()
        .take(LISTED)
        .map(|p| format!("{:.2} to {:.2} s", shown_s(p.from_s), shown_s(p.to_s)))
        .collect();
    let more = if periods.len() > LISTED { ", ..." } else { "" };
    format!(
        "{}, {:.2} s in all: {}{more}",
        periods.len(),
        shown_s(total),
        each.join(", ")
    )
}
