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
    /// What the tool passed over, because something stood in the way; null where it followed the
    /// whole path.
    pub passed_over: Option<PassedOver>,
}

/// Parts of the path that the tool passed over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PassedOver {
    /// Number of times that it did.
    pub times: usize,
    /// Share of the path's time, 0 to 1; null on a path with lifts of its own.
    pub path_share: Option<f64>,
}

impl PassedOver {
    /// Lifts on a path that has this many of its own.
    fn of(task: &TaskRun<'_>, planned: usize) -> Option<Self> {
        // The path goes on in the last cycle of a lift, or the first one after it. Where it does
        // not, the tool lifted to touch the surface around a place.
        let steps: Vec<f64> = task
            .cycles
            .windows(2)
            .filter(|pair| is_lift(&pair[0]))
            .map(|pair| pair[1].control.path_progress - pair[0].control.path_progress)
            .filter(|step| *step > 0.0)
            .collect();
        let (lifts, share) = (steps.len(), steps.iter().sum());
        (lifts > planned).then(|| Self {
            times: lifts - planned,
            path_share: (planned == 0).then_some(share),
        })
    }

    /// In words: `the tool passed over something in the way twice, 5 % of the path`.
    fn words(&self) -> String {
        let times = match self.times {
            1 => "once".to_owned(),
            2 => "twice".to_owned(),
            n => format!("{n} times"),
        };
        let share = self.path_share.map_or_else(String::new, |share| {
            format!(", {:.0} % of the path", 100.0 * share)
        });
        format!("the tool passed over something in the way {times}{share}")
    }
}

impl Events {
    /// Events of the last task of a recording, whose path has `lifts` of its own, if that is known.
    pub(crate) fn of(task: &TaskRun<'_>, lifts: Option<usize>) -> Self {
        let Some(last) = task.cycles.last() else {
            return Self::default();
        };
        // The landing after a way above the surface is no search for a lost one.
        let mut lands = false;
        let mut seeks = |cycle: &Cycle<'_>| {
            let phase = cycle.sample.phase;
            lands = is_lift(cycle) || lands && phase == Phase::Seek;
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
            passed_over: lifts.and_then(|lifts| PassedOver::of(task, lifts)),
        }
    }

    /// The verdict in a sentence: `stopped at 43 % of the path`.
    pub fn verdict_words(&self, fault: Option<&str>) -> String {
        let percent = 100.0 * self.progress.unwrap_or_default();
        match self.verdict {
            None => "no task".to_owned(),
            Some(Verdict::Completed) => self.passed_over.map_or_else(
                || "completed: the whole path was followed".to_owned(),
                |over| format!("completed, but {}", over.words()),
            ),
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

fn is_lift(cycle: &Cycle<'_>) -> bool {
    cycle.sample.phase == Phase::Lift
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
