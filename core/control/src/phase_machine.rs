//! Phases of a task, the same for all laws.
//!
//! ```text
//!            in doubt whether           without
//!            the tool is free           a tare
//!   idle ──┬───────────> clear ──┬──────────────────┐
//!          │                     v                  v
//!          └──────────────────> tare ──────────> approach
//!                                ^                  │ touch
//!             new zero, then     │                  v
//!             back by `seek`   clear <──────┐    contact <───┐ touch
//!                                           │       │ settled│
//!                                           │       v        │
//!                                           ├──── slide ──> seek <─── lift <─── slide
//!                                           │      ^ │       ^ contact lost
//!                             input is back │      │ v       │
//!                                           └───── hold ─────┘
//!                                                   │ path ended, and held
//!                                                   v
//!   done or fault <────────────────────────────── retract
//! ```
//!
//! A stop or a fault leads from every phase to `retract`; from `tare`, `clear` and `travel`, in
//! which nothing is touched, straight to the end. `hold` also stands in for a phase in which the
//! wrench is missing. A task with a start pose first goes through `travel`, after `clear` if there
//! is doubt, and one with a home pose goes through it again after `retract`. Which law takes which
//! path, and when, is in the law's own folder.

/// Phase of a task. The numeric value is `ControlState.phase`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Phase {
    /// No task.
    #[default]
    Idle = 0,
    /// Moving towards the surface.
    Approach = 1,
    /// The tool has touched; the force settles.
    Contact = 2,
    /// Following the path.
    Slide = 3,
    /// Moving off the surface.
    Retract = 4,
    /// Ended normally.
    Done = 5,
    /// Ended by a fault.
    Fault = 6,
    /// Pressing and standing still: paused, at the path's end, or without an estimate or a wrench.
    Hold = 7,
    /// Contact was lost; moving towards the surface again.
    Seek = 8,
    /// Standing still while the sensor's bias is measured.
    Tare = 9,
    /// Moving away from possible contact, before the sensor's bias is measured.
    Clear = 10,
    /// Moving in joint space to the task's start pose, or home after it.
    Travel = 11,
    /// Moving above the surface, from one stroke of the path to the next.
    Lift = 12,
}

impl Phase {
    /// All phases.
    pub const ALL: [Self; 13] = [
        Self::Idle,
        Self::Approach,
        Self::Contact,
        Self::Slide,
        Self::Retract,
        Self::Done,
        Self::Fault,
        Self::Hold,
        Self::Seek,
        Self::Tare,
        Self::Clear,
        Self::Travel,
        Self::Lift,
    ];

    /// Phase from the number in `ControlState.phase`.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// Name as in `ControlState.phase_text`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Approach => "approach",
            Self::Contact => "contact",
            Self::Slide => "slide",
            Self::Retract => "retract",
            Self::Done => "done",
            Self::Fault => "fault",
            Self::Hold => "hold",
            Self::Seek => "seek",
            Self::Tare => "tare",
            Self::Clear => "clear",
            Self::Travel => "travel",
            Self::Lift => "lift",
        }
    }

    /// Whether a task is running.
    pub fn is_active(self) -> bool {
        !matches!(self, Self::Idle | Self::Done | Self::Fault)
    }

    /// Whether the tool is meant to press on the surface.
    pub fn is_pressing(self) -> bool {
        matches!(self, Self::Contact | Self::Slide | Self::Hold)
    }

    /// Whether the tool is meant to touch nothing while the sensor may not be tared yet: the force
    /// then says nothing about a surface.
    pub fn is_before_approach(self) -> bool {
        matches!(self, Self::Tare | Self::Clear | Self::Travel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_distinct_and_numbers_fixed() {
        for (i, a) in Phase::ALL.iter().enumerate() {
            assert_eq!(*a as usize, i);
            assert_eq!(Phase::from_code(i as u8), Some(*a));
            for b in &Phase::ALL[..i] {
                assert_ne!(a.name(), b.name());
            }
        }
    }
}
