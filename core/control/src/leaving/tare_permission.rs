//! Whether the controller's last state forbids a tare: the sensor's service checks this before it
//! averages.

use std::fmt;

use crate::leaving::clearance::Clearance;
use crate::phase_machine::Phase;

/// Contact state of a controller, from `control/state`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControllerWord {
    /// Phase of the controller.
    pub phase: Phase,
    /// Whether the tool may touch something, since a task that did not end in free space.
    pub contact_possible: bool,
}

impl ControllerWord {
    /// State of a controller in `phase` with this `clearance` of the tool.
    pub fn of(phase: Phase, clearance: &Clearance) -> Self {
        Self {
            phase,
            contact_possible: !clearance.is_free(),
        }
    }
}

/// Why the controller's state forbids a tare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContactSign {
    /// The controller moves the arm or presses now.
    Active(Phase),
    /// The controller stands still, and the tool may touch something.
    Possible(Phase),
    /// The controller is silent; its last state was this phase.
    Remembered(Phase),
}

impl ContactSign {
    /// Reason from the controller's state `now`, or, if it is silent, from its `last` state, which
    /// is kept across restarts.
    pub fn of(now: Option<ControllerWord>, last: Option<ControllerWord>) -> Option<Self> {
        let moves = |word: &ControllerWord| word.phase.is_active() && word.phase != Phase::Tare;
        match (now, last) {
            (Some(word), _) if moves(&word) => Some(Self::Active(word.phase)),
            (Some(word), _) => word.contact_possible.then_some(Self::Possible(word.phase)),
            (None, Some(word)) => {
                (moves(&word) || word.contact_possible).then_some(Self::Remembered(word.phase))
            }
            (None, None) => None,
        }
    }

    /// Whether a person who has checked the tool may override the refusal: not while the controller
    /// moves or presses.
    pub fn can_be_waived(&self) -> bool {
        !matches!(self, Self::Active(_))
    }
}

impl fmt::Display for ContactSign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let look = "if you see that the tool hangs free, run `tangent tare --clear`";
        match self {
            Self::Active(phase) => write!(
                f,
                "the controller is in phase {}: stop the task first, it retracts",
                phase.name()
            ),
            Self::Possible(phase) => write!(
                f,
                "the tool may touch something: the last task (now {}) did not end in free space. Start a task, which \
                 moves off first, or {look}",
                phase.name()
            ),
            Self::Remembered(phase) => write!(
                f,
                "the tool may touch something: the controller publishes nothing; its last phase was {}. Start the \
                 controller and a task, which moves off first, or {look}",
                phase.name()
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn word(phase: Phase, contact_possible: bool) -> Option<ControllerWord> {
        Some(ControllerWord {
            phase,
            contact_possible,
        })
    }

    #[test]
    fn every_phase_that_moves_or_presses_refuses_whatever_a_person_says() {
        for phase in Phase::ALL {
            let sign = ContactSign::of(word(phase, false), None);
            if phase.is_active() && phase != Phase::Tare {
                assert_eq!(sign, Some(ContactSign::Active(phase)));
                assert!(!sign.unwrap().can_be_waived());
            } else {
                assert_eq!(sign, None);
            }
        }
    }

    #[test]
    fn a_doubt_outlasts_the_controller_and_a_person_may_settle_it() {
        let standing = ContactSign::of(word(Phase::Fault, true), None).unwrap();
        assert!(standing.can_be_waived());
        let silent = ContactSign::of(None, word(Phase::Slide, true)).unwrap();
        assert_eq!(silent, ContactSign::Remembered(Phase::Slide));
        assert!(silent.can_be_waived() && silent.to_string().contains("slide"));
        assert_eq!(ContactSign::of(None, word(Phase::Done, false)), None);
        // The controller is back with newer information.
        let back = ContactSign::of(word(Phase::Done, false), word(Phase::Slide, true));
        assert_eq!(back, None);
    }
}
