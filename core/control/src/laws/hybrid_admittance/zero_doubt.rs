//! The doubt of a sensor's zero that seems to have jumped: the tool lifts off and is tared anew,
//! which proves or disproves it.
//!
//! Asked by the run's senses each cycle whose reading is in doubt, answered by its phase machine.

/// Number of times that a tool lifts off to prove a zero in one run. If each has proved it, it is
/// the surface that makes the force jump.
const DOUBTS_MAX: u32 = 3;

/// What follows from a zero that seems to have jumped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ZeroJump {
    /// The tool lifts off for a new zero, which is refused if it is far from the last good one. A
    /// force that jumps at an edge looks the same as a zero that does.
    ToProve,
    /// Nothing: the zero is proved, or about to be.
    Proved,
    /// The sensor is faulty.
    Fault,
}

/// Doubts of one run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ZeroDoubt {
    asked: bool,
    open: bool,
    lifts: u32,
}

impl ZeroDoubt {
    /// What follows from a jump while the tool is on the surface.
    pub fn on_surface(&self) -> ZeroJump {
        if self.lifts < DOUBTS_MAX {
            ZeroJump::ToProve
        } else {
            ZeroJump::Proved
        }
    }

    /// Whether the tool has lifted off for a doubt that no tare has answered yet.
    pub fn is_open(&self) -> bool {
        self.open
    }

    /// Notes that the zero is in doubt: the tool is to lift off.
    pub fn ask(&mut self) {
        self.asked = true;
    }

    /// Whether the tool is to lift off now; it is told once.
    pub fn lifts_off(&mut self) -> bool {
        let lifts = std::mem::take(&mut self.asked);
        if lifts {
            self.open = true;
            self.lifts += 1;
        }
        lifts
    }

    /// A tare gave a good zero: the one in force was good as well.
    pub fn disprove(&mut self) {
        self.open = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doubt_is_open_until_a_tare_and_the_fourth_is_none() {
        let mut doubt = ZeroDoubt::default();
        assert!(!doubt.lifts_off() && !doubt.is_open());
        for _ in 0..3 {
            assert_eq!(doubt.on_surface(), ZeroJump::ToProve);
            doubt.ask();
            assert!(doubt.lifts_off() && doubt.is_open());
            assert!(!doubt.lifts_off() && doubt.is_open());
            doubt.disprove();
            assert!(!doubt.is_open());
        }
        assert_eq!(doubt.on_surface(), ZeroJump::Proved);
    }
}
