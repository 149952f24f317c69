//! The tasks of a recording.

use std::ops::Range;

use serde::Serialize;
use tangent_control::{Phase, Verdict};
use tangent_schemas::tangent::ControlState;

/// One task of a recording, in short.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskEntry {
    /// Number within the recording, from 1; chosen by `--task`.
    pub number: usize,
    /// Name in its task file.
    pub name: String,
    /// How it ended.
    pub verdict: Option<Verdict>,
    /// Share of the path that was followed, 0 to 1.
    pub progress: f64,
    /// Its controller states, by index.
    #[serde(skip)]
    pub states: Range<usize>,
}

impl TaskEntry {
    /// The task in a few words: `2 (wipe, stopped at 43 %)`.
    pub fn words(&self) -> String {
        let verdict = self.verdict.map_or("not begun", Verdict::name);
        let at = match self.verdict {
            Some(Verdict::Completed) => String::new(),
            _ => format!(" at {:.0} %", 100.0 * self.progress),
        };
        format!("{} ({}, {verdict}{at})", self.number, self.name)
    }
}

/// All tasks in order. A task ends with the next one, or when its controller restarts.
pub(crate) fn tasks(states: &[ControlState]) -> Vec<TaskEntry> {
    let mut found = Vec::new();
    let mut from = 0;
    for part in states.chunk_by(|a, b| a.activation == b.activation) {
        let range = from..from + part.len();
        from = range.end;
        let (Some(last), true) = (part.last(), part[0].activation > 0) else {
            continue;
        };
        let progress = part.iter().map(|s| s.path_progress).fold(0.0, f64::max);
        let named = part.iter().rev().find(|state| !state.task.is_empty());
        found.push(TaskEntry {
            number: found.len() + 1,
            name: named.map(|s| s.task.to_string()).unwrap_or_default(),
            verdict: Verdict::of(phase_of(last), progress),
            progress,
            states: range,
        });
    }
    found
}

/// The phase in a message; an unknown number, from a later version, counts as idle.
pub(crate) fn phase_of(control: &ControlState) -> Phase {
    Phase::from_code(control.phase).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use tangent_schemas::convert::cut;

    use super::*;

    #[test]
    fn a_restarted_controller_counts_from_one_again() {
        let state = |activation: u64, phase: Phase, progress: f64| ControlState {
            activation,
            phase: phase as u8,
            task: cut(["", "wipe"][usize::from(activation > 0)]),
            path_progress: progress,
            ..ControlState::default()
        };
        let states = [
            state(0, Phase::Idle, 0.0),
            state(1, Phase::Slide, 0.5),
            state(1, Phase::Done, 1.0),
            state(2, Phase::Slide, 0.43),
            state(0, Phase::Idle, 0.0),
            state(1, Phase::Fault, 0.2),
        ];
        let found = tasks(&states);
        let words: Vec<String> = found.iter().map(TaskEntry::words).collect();
        assert_eq!(
            words,
            [
                "1 (wipe, completed)",
                "2 (wipe, unfinished at 43 %)",
                "3 (wipe, faulted at 20 %)"
            ]
        );
        assert_eq!(found[1].states, 3..4);
    }
}
