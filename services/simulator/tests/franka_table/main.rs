//! The failure table of docs/architecture.md for an arm that takes torques over FCI: robot, Franka
//! bridge and `unified_force_impedance` stepped together at 1 kHz in simulated time, with the fault
//! in every cycle. The bounds are met exactly: no machine is in it.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

mod cell;
mod fault;
mod pairs;

use cell::Cell;
use fault::Fault;
use tangent_control::{Fault as TaskFault, Phase};
use tangent_franka::fci::{LOST_MAX, RobotMode};
use tangent_sensing::Validity;

/// Faults come in each of the path's first cycles.
const OFFSETS: u64 = 24;
/// Silence after which a task is latched out, cycles.
const LATCHED: u64 = 101;
/// Age beyond which a wrench is silent (two cycles and the sensor's jitter of 2 ms), and patience
/// after that, cycles.
const WRENCH_SILENT: u64 = 5;
const WRENCH_RETRACT: u64 = 100;
/// Age of the last frame beyond which the camera is dark, s.
const CAMERA_S: f64 = 0.3;
/// Cycles without a normal until the path's clock is slowed down, until it stands then, and until
/// the tool retracts.
const ESTIMATE: u64 = 100;
const CLOCK: u64 = 200;
const ESTIMATE_RETRACT: u64 = 1000;
/// In this time the arm has come to rest after its task was ended, cycles.
const REST: u64 = 700;
/// Slower than this it is at rest, rad/s.
pub const AT_REST: f64 = 2e-3;

/// Twice the reference, or 10 N: what the tool may press with whatever happens.
pub fn most_n(cell: &Cell) -> f64 {
    (2.0 * cell.reference_n()).max(10.0)
}

/// Sliding, and from the next cycle on with `fault`.
fn with(fault: Fault, offset: u64) -> Cell {
    let mut cell = Cell::sliding();
    cell.steps(offset);
    assert_eq!(cell.phase(), Phase::Slide);
    cell.faults = vec![fault];
    cell
}

/// Every offset, one of `n` faults that are judged alike at each.
fn shared<const N: usize>(faults: [Fault; N]) -> impl Iterator<Item = (Fault, u64)> {
    (0..OFFSETS).map(move |offset| (faults[offset as usize % N], offset))
}

/// How it ends is looked at in some of the cycles.
fn is_followed(offset: u64) -> bool {
    offset % 8 < 4 && offset % 5 < 2
}

/// It retracts along the normal and stands.
fn off_the_surface(cell: &mut Cell, what: &str) {
    cell.until("it has left", |c| !c.phase().is_active());
    cell.until("it rests", |c| c.robot_speed() < AT_REST);
    let (force_n, most_n) = (cell.truth().wrench.force.norm(), most_n(cell));
    assert_eq!(force_n, 0.0, "{what}");
    assert!(cell.peak_n <= most_n, "{what}: {} N", cell.peak_n);
}

/// The task is over and the arm rests, and stays so when the fault is over.
fn stands(cell: &mut Cell, what: &str) {
    cell.steps(REST);
    let speed = cell.robot_speed();
    assert!(speed < AT_REST, "{what}: {speed} rad/s");
    cell.faults.clear();
    cell.steps(1000);
    assert!(!cell.phase().is_active(), "{what}: {:?}", cell.phase());
    assert!(cell.robot_speed() < AT_REST, "{what}: moves again");
    let most_n = most_n(cell);
    assert!(cell.peak_n <= most_n, "{what}: {} N", cell.peak_n);
}

/// Two cycles are followed with the command before, in the third the hold begins with the torque in
/// force, and from the fourth on it fades.
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
            stands(&mut cell, &what);
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
            // The hold begins with the torque in force.
            assert_eq!(cell.answered == last, cycle == 1, "{what}, cycle {cycle}");
            assert_eq!(gate.admission.refused(), refused + cycle, "{what}");
            let latched = gate.admission.activation_latched() >= activation;
            assert_eq!(latched, cycle == LATCHED, "{what}, cycle {cycle}");
        }
        if is_followed(offset) {
            stands(&mut cell, &what);
        }
    }
}

#[test]
fn a_second_source_is_refused_in_its_cycle_and_the_first_notices_nothing() {
    for offset in (0..OFFSETS).step_by(10) {
        let mut cell = with(Fault::SecondSource, offset);
        let mut alone = Cell::sliding();
        alone.steps(offset);
        for cycle in 1..=100 {
            cell.step();
            alone.step();
            assert_eq!(cell.bridge().lease().refused(), cycle);
            assert_eq!(cell.answered, alone.answered, "{offset}, {cycle}");
        }
        let rival = cell.bridge().lease().rival(cell.now_s()).unwrap();
        assert_eq!(rival.to_string(), "controller/other-2");
    }
}

/// Answers that come late by a cycle, states that come twice, and half of either: no task ends for
/// it.
#[test]
fn what_is_borne_is_borne() {
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
        assert!(cell.peak_n <= most_n(&cell), "{fault:?}: {} N", cell.peak_n);
        assert_eq!(cell.bridge().gate().admission.refused(), 0, "{fault:?}");
    }
}

/// The robot stops by itself; its task ends with the first state that says so, and the arm moves
/// again for a start alone.
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
        // Until a state comes that says it.
        cell.steps(match fault {
            Fault::AnswersLost => 1,
            Fault::StateLate => 3,
            _ => 0,
        });
        if matches!(fault, Fault::StatesLost | Fault::BridgeHung) {
            cell.steps(30);
            cell.faults.clear();
            cell.step();
        }
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let why = cell.output.unwrap().fault;
        assert_eq!(why, Some(TaskFault::ArmNotReady), "{what}");
        let latched = cell.bridge().gate().admission.activation_latched();
        assert!(latched >= activation, "{what}");
        if is_followed(offset) {
            cell.until("the task is over", |c| !c.phase().is_active());
            stands(&mut cell, &what);
            assert_eq!(cell.mode(), RobotMode::Reflex, "{what}: left by itself");
        }
    }
}

/// It says so, and not that the tool were not free.
#[test]
fn a_robot_that_stops_while_the_tool_moves_off_ends_the_task() {
    let mut cell = Cell::in_phase(Phase::Clear);
    cell.step();
    assert_eq!(cell.phase(), Phase::Clear);
    cell.faults.push(Fault::UserStop);
    for _ in 0..2 {
        cell.step();
    }
    assert!(!cell.phase().is_active(), "{:?}", cell.phase());
    let why = cell.output.unwrap().fault;
    assert_eq!(why, Some(TaskFault::ArmNotReady));
}

/// The task is over with the first state that says so.
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
            stands(&mut cell, &what);
        }
    }
}

/// The robot holds itself from that cycle on, and what was commanded before is latched out when the
/// bridge is there again.
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
            assert!(cell.robot_speed() < AT_REST, "{what}");
            cell.faults.clear();
            cell.until("the arm is ready", Cell::is_ready);
            cell.until("the task is over", |c| !c.phase().is_active());
            stands(&mut cell, &what);
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
            off_the_surface(&mut cell, &what);
        }
    }
}

/// A standstill of less than 3 ms is a hiccup of the robot.
#[test]
fn an_estimate_that_does_not_live_retracts_within_four_states() {
    for (fault, offset) in shared([Fault::WrenchFrozen, Fault::AxisStuck]) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let (decides, validity) = match fault {
            Fault::WrenchFrozen => (3, Validity::Frozen),
            _ => (4, Validity::AxisStuck),
        };
        for cycle in 1..=decides {
            assert_eq!(cell.phase(), Phase::Slide, "{what}, cycle {cycle}");
            cell.step();
        }
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let why = cell.output.unwrap().fault;
        assert_eq!(why, Some(TaskFault::Wrench(validity)), "{what}");
        if is_followed(offset) {
            off_the_surface(&mut cell, &what);
        }
    }
}

#[test]
fn a_silent_wrench_stops_and_retracts_after_its_patience() {
    for offset in 0..OFFSETS {
        let what = format!("{offset}");
        let mut cell = with(Fault::WrenchSilent, offset);
        let mut stops = 0;
        while cell.phase() == Phase::Slide {
            cell.step();
            stops += 1;
        }
        assert_eq!(cell.phase(), Phase::Hold, "{what}");
        // An age of just the limit is decided by rounding.
        assert!(
            (WRENCH_SILENT - 1..=WRENCH_SILENT).contains(&stops),
            "{what}: {stops}"
        );
        let mut waits = 1_u64;
        while cell.phase() == Phase::Hold {
            cell.step();
            waits += 1;
        }
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        assert!(waits.abs_diff(WRENCH_RETRACT + 1) <= 1, "{what}: {waits}");
        if is_followed(offset) {
            off_the_surface(&mut cell, &what);
        }
    }
}

#[test]
fn without_any_normal_the_path_stops_and_the_tool_retracts_after_a_second() {
    for offset in (0..OFFSETS).step_by(5) {
        let mut cell = with(Fault::EstimatesSilent, offset);
        // The cycle in which the last frame is too old.
        let blind = ((cell.seen_s() + CAMERA_S) * 1000.0).floor() as u64 + 1;
        let mut stopped = None;
        while cell.phase() != Phase::Retract {
            cell.step();
            let cycle = cell.cycle;
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
        let retracts = cell.cycle - blind;
        assert!(
            retracts.abs_diff(ESTIMATE_RETRACT) <= 2,
            "{offset}: {retracts}"
        );
        let why = cell.output.unwrap().fault;
        assert!(matches!(why, Some(TaskFault::Estimate(_))), "{why:?}");
        off_the_surface(&mut cell, &format!("{offset}"));
    }
}

/// The law counts its patience by the robot's clock, not in the states that came.
#[test]
fn without_any_normal_and_half_of_the_states_the_tool_retracts_after_a_second() {
    let mut cell = with(Fault::EstimatesSilent, 0);
    let blind = ((cell.seen_s() + CAMERA_S) * 1000.0).floor() as u64 + 1;
    cell.faults.push(Fault::StatesThinned);
    cell.until("it retracts", |c| c.phase() == Phase::Retract);
    let retracts = cell.cycle - blind;
    assert!(retracts.abs_diff(ESTIMATE_RETRACT) <= 4, "{retracts}");
}

/// Eye and touch stand in for each other, and touch does not believe an eye that is wrong.
#[test]
fn one_sense_is_enough_to_go_on() {
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
        assert!(cell.peak_n <= most_n(&cell), "{fault:?}: {} N", cell.peak_n);
    }
}

#[test]
fn a_lost_contact_is_sought_after_thirty_milliseconds() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::ContactLost, offset);
        for cycle in 1..=30 {
            assert_eq!(cell.phase(), Phase::Slide, "{offset}, cycle {cycle}");
            cell.step();
        }
        assert_eq!(cell.phase(), Phase::Seek, "{offset}");
        let progress = cell.output.unwrap().path_progress;
        // It is felt again: the path goes on from where it stood.
        cell.faults.clear();
        cell.until("it slides again", |c| {
            let slides = c.phase() == Phase::Slide;
            assert!(slides || c.output.unwrap().path_progress == progress);
            slides
        });
        assert!(cell.peak_n <= most_n(&cell), "{} N", cell.peak_n);
    }
}
