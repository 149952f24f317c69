//! Two faults at the same time, and the state after one fault.

use tangent_control::Phase;
use tangent_simulated_ur::Flavour;

use crate::cell::Cell;
use crate::fault::Fault;
use crate::table::TableCell;
use crate::table::pairs::{
    PHASES, PairCell, Play, PlayOf, a_new_start_shows_the_true_force, anywhere, both_orders,
    come_to_rest, faults, judge_all, share, true_n,
};

/// Cycles at 125 Hz between two faults, and from the begin of the phase to the first one.
const TIMES: [(u64, u64); 5] = [(0, 0), (1, 7), (3, 13), (14, 21), (60, 5)];

impl PairCell for Cell {
    /// A protective stop is unlocked after 5 s, and then the program is sent again.
    fn rest(&self) -> (u64, u64) {
        (self.cycles_in(12.0), self.cycles_in(0.2))
    }

    /// Converts cycles at 125 Hz.
    fn cycles(&self, of_play: u64) -> u64 {
        (of_play as f64 * 0.008 / self.period_s()).round() as u64
    }

    /// The effects of a silent estimate take a second. A zero that has jumped is refused for
    /// `timeouts.tare_s` before the task ends.
    fn lasts(&self, play: &PlayOf<Self>) -> u64 {
        self.cycles_in(if play.has(Fault::ZeroJumped) {
            8.0
        } else if play.has(Fault::EstimateSilent) {
            1.2
        } else {
            0.5
        })
    }

    /// The bridge could move the arm, or waits for a person.
    fn rests(&self) -> bool {
        !self.phase().is_active() && self.robot_speed() < Self::AT_REST && self.is_ready()
    }

    fn finish(&mut self, play: &PlayOf<Self>) {
        if play.phase != Phase::Slide {
            // A task that could wait for the fault's end continues.
            self.steps(self.cycles_in(2.0));
            self.stop_task();
        } else if !play.ends_task() {
            assert_eq!(self.phase(), Phase::Slide, "{play:?}");
            return;
        }
        come_to_rest(self, play);
    }

    fn make_ready(&mut self) {
        self.reset_bridge();
        self.until("the bridge is ready", Self::is_ready);
    }

    /// Largest difference of shown and true force in 250 cycles, N.
    fn shown_off_n(&mut self) -> f64 {
        let mut worst_n = 0.0_f64;
        for _ in 0..250 {
            self.step();
            worst_n = worst_n.max((self.shown_n() - true_n(self)).abs());
        }
        worst_n
    }
}

/// Tests the first half of the pairs, or the second, so that two threads share them.
fn half(of: usize) {
    let times = |i| TIMES[i % TIMES.len()];
    let all = both_orders::<Cell>(Flavour::Cb3, Phase::Slide, times);
    judge_all::<Cell>(share(all, of, 2));
}

#[test]
fn no_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    half(0);
}

#[test]
fn no_other_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    half(1);
}

#[test]
#[ignore = "every pair in every phase, minutes: .ci/search"]
fn no_two_faults_in_any_phase_at_125_hz() {
    anywhere::<Cell>(Flavour::Cb3, "Cb3 ", 80, 40);
}

#[test]
#[ignore = "every pair in every phase, minutes: .ci/search"]
fn no_two_faults_in_any_phase_at_500_hz() {
    anywhere::<Cell>(Flavour::ESeries, "ESeries ", 80, 40);
}

/// Each fault alone, in every phase.
#[test]
fn no_fault_in_any_phase_presses_hard_or_leaves_the_arm_in_motion() {
    judge_all::<Cell>(PHASES.into_iter().flat_map(|phase| {
        faults::<Cell>().enumerate().map(move |(i, fault)| {
            let flavour = [Flavour::Cb3, Flavour::ESeries][i % 2];
            Play::alone(flavour, phase, fault, TIMES[i % TIMES.len()].1 / 2)
        })
    }));
}

#[test]
fn after_every_fault_a_new_start_shows_the_true_force() {
    let alone = faults::<Cell>().enumerate();
    a_new_start_shows_the_true_force::<Cell>(
        alone
            .filter(|(_, fault)| *fault != Fault::SecondSource)
            .map(|(i, fault)| Play::alone(Flavour::Cb3, Phase::Slide, fault, [0, 9][i % 2])),
    );
}
