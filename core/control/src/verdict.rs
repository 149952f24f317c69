//! How a task ended, for people and programs that have to tell success from everything else.

use serde::Serialize;

use crate::phase_machine::Phase;

/// Share of the path from which it counts as complete: less is a rounding error.
const COMPLETE: f64 = 1.0 - 1e-6;

/// End of a task. Only [`Verdict::Completed`] is a success: a task that is stopped also retracts
/// and ends in [`Phase::Done`], but with a part of its path left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The whole path was followed, and the tool retracted.
    Completed,
    /// It was stopped, and the tool retracted; a part of the path is left.
    Stopped,
    /// A fault ended it.
    Faulted,
    /// It has not ended.
    Unfinished,
}

impl Verdict {
    /// Verdict by the last phase of a task and its progress along the path, 0 to 1; `None` without
    /// a task.
    ///
    /// ```
    /// use tangent_control::{Phase, Verdict};
    /// assert_eq!(Verdict::of(Phase::Done, 0.4), Some(Verdict::Stopped));
    /// ```
    pub fn of(phase: Phase, progress: f64) -> Option<Self> {
        match phase {
            Phase::Idle => None,
            Phase::Fault => Some(Self::Faulted),
            Phase::Done if progress >= COMPLETE => Some(Self::Completed),
            Phase::Done => Some(Self::Stopped),
            _ => Some(Self::Unfinished),
        }
    }

    /// The verdict in a word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Stopped => "stopped",
            Self::Faulted => "faulted",
            Self::Unfinished => "unfinished",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_path_without_a_fault_is_completed() {
        for phase in Phase::ALL {
            for progress in [0.0, 0.999, 1.0] {
                let completed = Verdict::of(phase, progress) == Some(Verdict::Completed);
                assert_eq!(completed, phase == Phase::Done && progress == 1.0);
            }
        }
        assert_eq!(Verdict::of(Phase::Idle, 0.0), None);
        assert_eq!(Verdict::of(Phase::Fault, 1.0), Some(Verdict::Faulted));
        assert_eq!(Verdict::of(Phase::Slide, 0.5), Some(Verdict::Unfinished));
    }
}
