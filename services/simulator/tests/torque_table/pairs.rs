//! Two faults at the same time, and the state after one fault.

use tangent_control::Phase;

use crate::cell::Cell;
use crate::fault::Fault;
use crate::table::pairs::{
    PairCell, Play, PlayOf, a_new_start_shows_the_true_force, anywhere, every_second_phase, faults,
    one_order,
};
use crate::table::{TableCell, TableFault};

impl PairCell for Cell {
    fn rest(&self) -> (u64, u64) {
        (6_000, 100)
    }

    /// The effects of a silent estimate take more than a second.
    fn lasts(&self, play: &PlayOf<Self>) -> u64 {
        if play.has(Fault::EstimateSilent) || play.has(Fault::CameraDark) {
            1_200
        } else {
            300
        }
    }

    /// A start is refused while another source holds the arm.
    fn make_ready(&mut self) {
        self.until("the arm is its own", Self::is_ready);
    }
}

fn all() -> Vec<Fault> {
    faults::<Cell>().collect()
}

#[test]
fn no_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    one_order::<Cell>(&all(), 0, 2);
}

#[test]
fn no_other_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    one_order::<Cell>(&all(), 1, 2);
}

#[test]
fn no_fault_in_any_phase_presses_hard_or_leaves_the_arm_in_motion() {
    every_second_phase::<Cell>(&all());
}

#[test]
#[ignore = "every pair in every phase, minutes: .ci/search"]
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
