//! Two faults at the same time, and the state after one fault.

use tangent_control::Phase;

use crate::cell::Cell;
use crate::fault::Fault;
use crate::table::pairs::{
    PairCell, Play, PlayOf, a_new_start_shows_the_true_force, anywhere, every_second_phase, faults,
    one_order,
};
use crate::table::{TableCell, TableFault};

/// One fault of each kind that bridge and law treat identically. Answers to a future state, or
/// repeated ones, are treated as old ones. A frame without numbers is treated as none. A state that
/// arrives twice is not answered, and the answer to a late one is lost. A connection that is cut
/// has the result of a dead bridge.
const DISTINCT: [Fault; 21] = [
    Fault::BridgeDead,
    Fault::BridgeHung,
    Fault::NoCommand,
    Fault::ControllerDead,
    Fault::CommandNan,
    Fault::CommandOld,
    Fault::CommandSwapped,
    Fault::SecondSource,
    Fault::StatesLost,
    Fault::StatesThinned,
    Fault::StateNan,
    Fault::AnswersLost,
    Fault::WrenchSilent,
    Fault::WrenchNan,
    Fault::WrenchFrozen,
    Fault::CameraDark,
    Fault::CameraAskew,
    Fault::TouchSilent,
    Fault::EstimatesSilent,
    Fault::Collision,
    Fault::UserStop,
];

impl PairCell for Cell {
    fn rest(&self) -> (u64, u64) {
        (8_000, 100)
    }

    /// The effects of silent estimates take more than a second of the robot's clock, by which the
    /// law measures its timeouts. With half of the states lost, the play lasts twice as long.
    fn lasts(&self, play: &PlayOf<Self>) -> u64 {
        let camera = [Fault::CameraDark, Fault::CameraNan, Fault::CameraAskew];
        let no_camera = camera.into_iter().any(|fault| play.has(fault));
        let blind = play.has(Fault::EstimatesSilent) || no_camera && play.has(Fault::TouchSilent);
        match (blind, play.has(Fault::StatesThinned)) {
            (true, true) => 3_200,
            (true, false) => 1_600,
            _ => 300,
        }
    }

    /// While touch is silent, no input shows that a camera is wrong.
    fn can_be_known(play: &PlayOf<Self>) -> bool {
        let no_touch = play.has(Fault::TouchSilent) || play.has(Fault::EstimatesSilent);
        !(play.has(Fault::CameraAskew) && no_touch)
    }

    fn make_ready(&mut self) {
        self.steps(1200);
        if !self.is_ready() {
            // The robot leaves a reflex when a person requests it.
            self.recover();
        }
        self.until("the arm is ready", Self::is_ready);
    }
}

#[test]
fn no_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    one_order::<Cell>(&DISTINCT, 0, 2);
}

#[test]
fn no_other_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    one_order::<Cell>(&DISTINCT, 1, 2);
}

#[test]
fn no_fault_in_any_phase_presses_hard_or_leaves_the_arm_in_motion() {
    every_second_phase::<Cell>(&DISTINCT);
}

#[test]
#[ignore = "every pair in every phase, half an hour: .ci/search"]
fn no_two_faults_in_any_phase() {
    anywhere::<Cell>((), "", 400, 300);
}

#[test]
fn after_every_fault_a_new_start_shows_the_true_force() {
    let ending = faults::<Cell>().filter(|fault| !fault.is_tolerated());
    a_new_start_shows_the_true_force::<Cell>(
        ending.map(|fault| Play::alone((), Phase::Slide, fault, 9)),
    );
}
