//! The failure table of docs/architecture.md for an arm with torque commands over FCI: robot,
//! Franka bridge and `unified_force_impedance` are stepped together at 1 kHz in simulated time,
//! with the fault in every cycle. The bounds are met exactly, because no real machine is involved.

// Everything in this file is test code: a panic fails the test.
#![allow(clippy::unwrap_used)]

mod cell;
mod fault;
mod pairs;
#[path = "../table/mod.rs"]
mod table;

use cell::Cell;
use fault::Fault;
use table::{TableCell, second_source_changes_nothing};
use tangent_control::{Fault as TaskFault, Phase};
use tangent_franka::fci::{LOST_MAX, RobotMode};
use tangent_sensing::Validity;

/// A fault begins in each of this many first cycles of the path.
const OFFSETS: u64 = 24;
/// Silence after which the activation of a task is rejected, cycles.
const LATCHED: u64 = 101;
/// Age beyond which a wrench counts as silent (two cycles and the sensor's jitter of 2 ms), cycles,
/// and the timeout after that, cycles.
const WRENCH_SILENT: u64 = 5;
const WRENCH_RETRACT: u64 = 100;
/// Age of the last frame beyond which the camera counts as dark, s.
const CAMERA_S: f64 = 0.3;
/// Cycles without a normal until the path's clock slows down, then until it stops, and then until
/// the tool retracts.
const ESTIMATE: u64 = 100;
const CLOCK: u64 = 200;
const ESTIMATE_RETRACT: u64 = 1000;
/// Time in which the arm comes to rest after its task has ended, cycles.
const REST: u64 = 700;

/// A cell that slides, with `fault` from the next cycle on.
fn with(fault: Fault, offset: u64) -> Cell {
    Cell::with((), fault, offset)
}

/// Every offset, each with one of `N` faults that have the same expected result.
fn shared<const N: usize>(faults: [Fault; N]) -> impl Iterator<Item = (Fault, u64)> {
    table::shared(OFFSETS, faults)
}

/// Whether the end of the fault is tested too; that is done for some of the cycles.
fn is_followed(offset: u64) -> bool {
    offset % 8 < 4 && offset % 5 < 2
}

/// For two cycles the previous command is kept; in the third the hold begins with the present
/// torque, and from the fourth on this torque fades.
#[test]
fn without_a_good_command_the_bridge_follows_for_two_cycles_then_holds_and_latches_after_a_tenth_of_a_second()
 {
    let faults = [
        Fault::NoCommand,
        Fault::ControllerDead,
        Fault::CommandOld,
        Fault::CommandAhead,
        Fault::CommandRepeated,
    ];
    for (fault, offset) in shared(faults) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let (last, activation) = (cell.answered, cell.activation());
        let gate = cell.bridge().gate();
        let (missed, refused) = (gate.admission.missed(), gate.admission.refused());
        let silent = matches!(fault, Fault::NoCommand | Fault::ControllerDead);
        for cycle in 1..=LATCHED {
            cell.step();
            let gate = cell.bridge().gate();
            assert_eq!(cell.answered == last, cycle <= 3, "{what}, cycle {cycle}");
            assert_eq!(
                gate.admission.missed(),
                missed + cycle,
                "{what}, cycle {cycle}"
            );
            let counted = if silent { 0 } else { cycle };
            assert_eq!(gate.admission.refused(), refused + counted, "{what}");
            let latched = gate.admission.activation_latched() >= activation;
            assert_eq!(latched, cycle == LATCHED, "{what}, cycle {cycle}");
        }
        if is_followed(offset) {
            cell.assert_stands(&what, REST, 1000);
        }
    }
}

#[test]
fn a_bad_command_is_refused_and_the_arm_held_in_its_cycle() {
    for (fault, offset) in shared([Fault::CommandNan, Fault::CommandStrong]) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let (last, activation) = (cell.answered, cell.activation());
        let refused = cell.bridge().gate().admission.refused();
        for cycle in 1..=LATCHED {
            cell.step();
            let gate = cell.bridge().gate();
            // The hold begins with the present torque.
            assert_eq!(cell.answered == last, cycle == 1, "{what}, cycle {cycle}");
            assert_eq!(gate.admission.refused(), refused + cycle, "{what}");
            let latched = gate.admission.activation_latched() >= activation;
            assert_eq!(latched, cycle == LATCHED, "{what}, cycle {cycle}");
        }
        if is_followed(offset) {
            cell.assert_stands(&what, REST, 1000);
        }
    }
}

#[test]
fn a_second_source_is_refused_in_its_cycle_and_the_first_notices_nothing() {
    for offset in (0..OFFSETS).step_by(10) {
        let mut alone = Cell::sliding(());
        alone.steps(offset);
        let cells = (with(Fault::SecondSource, offset), alone);
        let refused = |cell: &Cell| cell.bridge().lease().refused();
        let cell = second_source_changes_nothing(cells, 100, refused, |cell| cell.answered);
        let rival = cell.bridge().lease().rival(cell.now_s()).unwrap();
        assert_eq!(rival.to_string(), "controller/other-2");
    }
}

/// Answers that are a cycle late, states that arrive twice, and half of the states or answers lost:
/// none of these ends a task.
#[test]
fn tolerated_faults_do_not_end_the_task() {
    let faults = [
        Fault::CommandSwapped,
        Fault::StateTwice,
        Fault::StatesThinned,
        Fault::AnswersThinned,
    ];
    for (fault, offset) in shared(faults).filter(|(_, offset)| offset % 3 == 0) {
        let mut cell = with(fault, offset);
        let answers = cell.answers;
        for cycle in 1..=1000 {
            cell.step();
            assert_eq!(cell.phase(), Phase::Slide, "{fault:?}, {offset}, {cycle}");
            assert_eq!(cell.mode(), RobotMode::Move, "{fault:?}, {offset}, {cycle}");
        }
        let arrived = cell.answers - answers;
        let thinned = matches!(fault, Fault::StatesThinned | Fault::AnswersThinned);
        assert_eq!(arrived, if thinned { 500 } else { 1000 }, "{fault:?}");
        cell.assert_force(&fault);
        assert_eq!(cell.bridge().gate().admission.refused(), 0, "{fault:?}");
    }
}

/// The robot stops by itself; its task ends with the first state that reports it, and only a new
/// start moves the arm again.
#[test]
fn twenty_lost_answers_are_a_reflex_and_end_the_task() {
    let faults = [
        Fault::AnswersLost,
        Fault::StatesLost,
        Fault::StateLate,
        Fault::BridgeHung,
    ];
    for (fault, offset) in shared(faults) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let activation = cell.activation();
        for cycle in 1..=u64::from(LOST_MAX) {
            assert_eq!(cell.mode(), RobotMode::Move, "{what}, cycle {cycle}");
            assert_eq!(cell.phase(), Phase::Slide, "{what}, cycle {cycle}");
            cell.step();
        }
        assert_eq!(cell.mode(), RobotMode::Reflex, "{what}");
        assert_eq!(cell.phase(), Phase::Slide, "{what}");
        // Until a state that reports it arrives.
        cell.steps(match fault {
            Fault::AnswersLost => 1,
            Fault::StateLate => 3,
            _ => 0,
        });
        if matches!(fault, Fault::StatesLost | Fault::BridgeHung) {
            cell.steps(30);
            cell.trial.faults.clear();
            cell.step();
        }
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let why = cell.output.unwrap().fault;
        assert_eq!(why, Some(TaskFault::ArmNotReady), "{what}");
        let latched = cell.bridge().gate().admission.activation_latched();
        assert!(latched >= activation, "{what}");
        if is_followed(offset) {
            cell.until("the task is over", |c| !c.phase().is_active());
            cell.assert_stands(&what, REST, 1000);
            assert_eq!(cell.mode(), RobotMode::Reflex, "{what}: left by itself");
        }
    }
}

/// The reported reason is the fault, not a tool that does not hang free.
#[test]
fn a_robot_that_stops_while_the_tool_moves_off_ends_the_task() {
    let mut cell = Cell::in_phase((), Phase::Clear);
    cell.step();
    assert_eq!(cell.phase(), Phase::Clear);
    cell.trial.faults.push(Fault::UserStop);
    for _ in 0..2 {
        cell.step();
    }
    assert!(!cell.phase().is_active(), "{:?}", cell.phase());
    let why = cell.output.unwrap().fault;
    assert_eq!(why, Some(TaskFault::ArmNotReady));
}

/// The task ends with the first state that reports the fault.
#[test]
fn a_robot_that_stops_by_itself_ends_the_task() {
    for (fault, offset) in shared([Fault::UserStop, Fault::Collision]) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let activation = cell.activation();
        while cell.mode() == RobotMode::Move && cell.phase() == Phase::Slide {
            cell.step();
        }
        if fault == Fault::Collision {
            assert_eq!(cell.mode(), RobotMode::Reflex, "{what}");
            cell.step();
        } else {
            assert_eq!(cell.mode(), RobotMode::UserStopped, "{what}");
        }
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let latched = cell.bridge().gate().admission.activation_latched();
        assert!(latched >= activation, "{what}");
        if is_followed(offset) {
            cell.until("the task is over", |c| !c.phase().is_active());
            cell.assert_stands(&what, REST, 1000);
        }
    }
}

/// The robot holds itself from that cycle on, and earlier commands are rejected when the bridge has
/// restarted.
#[test]
fn without_a_connection_the_robot_holds_itself() {
    let faults = [Fault::BridgeDead, Fault::Disconnected, Fault::StateNan];
    for (fault, offset) in shared(faults) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let activation = cell.activation();
        cell.step();
        assert_eq!(cell.mode(), RobotMode::Idle, "{what}");
        if fault != Fault::BridgeDead {
            let latched = cell.bridge().gate().admission.activation_latched();
            assert!(latched >= activation, "{what}");
        }
        if is_followed(offset) {
            cell.steps(REST);
            assert!(cell.robot_speed() < Cell::AT_REST, "{what}");
            cell.trial.faults.clear();
            cell.until("the arm is ready", Cell::is_ready);
            cell.until("the task is over", |c| !c.phase().is_active());
            cell.assert_stands(&what, REST, 1000);
        }
    }
}

#[test]
fn a_bad_wrench_retracts_in_its_second_cycle() {
    let faults = [Fault::WrenchNan, Fault::WrenchError];
    for (fault, offset) in shared(faults) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        cell.step();
        assert_eq!(cell.phase(), Phase::Slide, "{what}");
        cell.step();
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let why = cell.output.unwrap().fault;
        let validity = match fault {
            Fault::WrenchNan => Validity::NotFinite,
            _ => Validity::SensorError,
        };
        assert_eq!(why, Some(TaskFault::Wrench(validity)), "{what}");
        if is_followed(offset) {
            cell.assert_leaves_the_surface(&what);
        }
    }
}

/// One axis may repeat by chance in more states than the whole estimate.
#[test]
fn a_frozen_estimate_retracts_within_five_states() {
    for (fault, offset) in shared([Fault::WrenchFrozen, Fault::AxisStuck]) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        // A single axis counts only in states in which the others turn: one of them may not.
        let (decides, validity) = match fault {
            Fault::WrenchFrozen => (3..=3, Validity::Frozen),
            _ => (4..=5, Validity::AxisStuck),
        };
        let states = cell.cycles_of_phase(Phase::Slide);
        assert!(decides.contains(&states), "{what}: {states}");
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let found = Some(TaskFault::Wrench(validity));
        assert_eq!(cell.task_fault(), found, "{what}");
        if is_followed(offset) {
            cell.assert_leaves_the_surface(&what);
        }
    }
}

#[test]
fn a_silent_wrench_stops_and_retracts_after_its_patience() {
    for offset in 0..OFFSETS {
        let what = format!("{offset}");
        let mut cell = with(Fault::WrenchSilent, offset);
        cell.assert_stops_then_retracts(&what, WRENCH_SILENT - 1..=WRENCH_SILENT, WRENCH_RETRACT);
        if is_followed(offset) {
            cell.assert_leaves_the_surface(&what);
        }
    }
}

#[test]
fn without_any_normal_the_path_stops_and_the_tool_retracts_after_a_second() {
    for offset in (0..OFFSETS).step_by(5) {
        let mut cell = with(Fault::EstimatesSilent, offset);
        // The first cycle in which the last frame is too old.
        let blind = ((cell.seen_s() + CAMERA_S) * 1000.0).floor() as u64 + 1;
        let mut stopped = None;
        while cell.phase() != Phase::Retract {
            cell.step();
            let cycle = cell.trial.cycle;
            assert!(cycle < blind + 2 * ESTIMATE_RETRACT, "{offset}");
            if cell.phase() == Phase::Hold {
                let at = cell.output.unwrap().path_progress;
                let (since, stood) = *stopped.get_or_insert((cycle, at));
                assert_eq!(at, stood, "{offset}: the path goes on");
                let force_n = cell.truth().wrench.force.norm();
                let off = (force_n - cell.reference_n()).abs();
                assert!(off < 4.0, "{offset}, {}: {force_n} N", cycle - since);
            }
        }
        let (since, _) = stopped.unwrap();
        let stops = since - blind;
        assert!(stops.abs_diff(ESTIMATE + CLOCK) <= 2, "{offset}: {stops}");
        let retracts = cell.trial.cycle - blind;
        assert!(
            retracts.abs_diff(ESTIMATE_RETRACT) <= 2,
            "{offset}: {retracts}"
        );
        let why = cell.output.unwrap().fault;
        assert!(matches!(why, Some(TaskFault::Estimate(_))), "{why:?}");
        cell.assert_leaves_the_surface(&format!("{offset}"));
    }
}

/// The law measures its timeouts by the robot's clock, not by the number of states received.
#[test]
fn without_any_normal_and_half_of_the_states_the_tool_retracts_after_a_second() {
    let mut cell = with(Fault::EstimatesSilent, 0);
    let blind = ((cell.seen_s() + CAMERA_S) * 1000.0).floor() as u64 + 1;
    cell.trial.faults.push(Fault::StatesThinned);
    cell.until("it retracts", |c| c.phase() == Phase::Retract);
    let retracts = cell.trial.cycle - blind;
    assert!(retracts.abs_diff(ESTIMATE_RETRACT) <= 4, "{retracts}");
}

/// Camera and touch replace each other, and touch is kept when the camera is wrong.
#[test]
fn one_kind_of_estimate_is_enough_to_continue() {
    let faults = [
        Fault::CameraDark,
        Fault::CameraNan,
        Fault::CameraAskew,
        Fault::TouchSilent,
    ];
    for (fault, offset) in shared(faults).filter(|(_, offset)| offset % 3 == 0) {
        let mut cell = with(fault, offset);
        for cycle in 1..=2000 {
            cell.step();
            assert_eq!(cell.phase(), Phase::Slide, "{fault:?}, {offset}, {cycle}");
            let off = cell.output.unwrap().normal.angle(&cell.truth().normal);
            assert!(off < 0.2, "{fault:?}, {offset}, {cycle}: {off} rad");
        }
        cell.assert_force(&fault);
    }
}

#[test]
fn a_lost_contact_is_sought_after_thirty_milliseconds() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::ContactLost, offset);
        cell.assert_seeks_after(&format!("{offset}"), 30);
    }
}
