//! The failure table of docs/architecture.md for an arm with torque commands from
//! `hybrid_dynamics`: arm, object, sensor and camera, the gate before the motors and the law are
//! stepped together at 1 kHz in simulated time. The bounds are met exactly, because no real machine
//! is involved.

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
use tangent_actuation::Refusal;
use tangent_control::{Fault as TaskFault, Phase};
use tangent_sensing::Validity;

/// A fault begins in each of this many first cycles of the path.
const OFFSETS: u64 = 24;
/// Silence after which the activation of a task is rejected, cycles.
const LATCHED: u64 = 101;
/// Longest time for which an axis can keep its value by the noise of this sensor, whose normal axis
/// has a resolution of 0.05 N, cycles.
const AXIS_STUCK: u64 = 60;
/// Timeout of a silent wrench after the stop, cycles.
const WRENCH_RETRACT: u64 = 100;
/// Cycles without an estimate until the path's clock slows down, then until it stops, and then
/// until the tool retracts.
const ESTIMATE: u64 = 100;
const CLOCK: u64 = 200;
const ESTIMATE_RETRACT: u64 = 1000;
/// Time in which the arm comes to rest after its task has ended, cycles.
const REST: u64 = 300;

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
    offset % 8 < 4
}

/// The last torques are kept for two periods; in the third the arm brakes.
#[test]
fn without_a_command_the_gate_waits_two_periods_then_brakes_and_latches_after_a_tenth_of_a_second()
{
    let faults = [
        Fault::NoCommand,
        Fault::ControllerDead,
        Fault::StateSilent,
        Fault::CommandRepeated,
    ];
    for (fault, offset) in shared(faults) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let (last, activation) = (cell.given(), cell.activation());
        let missed = cell.gate().admission().missed();
        for cycle in 1..=LATCHED {
            cell.step();
            assert_eq!(cell.given() == last, cycle <= 2, "{what}, cycle {cycle}");
            assert_eq!(cell.gate().admission().missed(), missed + cycle, "{what}");
            let latched = cell.gate().admission().activation_latched() >= activation;
            assert_eq!(latched, cycle == LATCHED, "{what}, cycle {cycle}");
        }
        if is_followed(offset) {
            cell.assert_stands(&what, REST, 1500);
        }
    }
}

#[test]
fn a_bad_command_is_refused_and_the_arm_brakes_in_its_period() {
    let faults = [
        Fault::CommandNan,
        Fault::CommandStrong,
        Fault::CommandKind,
        Fault::CommandOld,
        Fault::CommandAhead,
    ];
    for (fault, offset) in shared(faults) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let (last, activation) = (cell.given(), cell.activation());
        let refused = cell.gate().admission().refused();
        cell.step();
        let gate = cell.gate();
        let named = match gate.admission().refusal().unwrap() {
            Refusal::NotFinite => fault == Fault::CommandNan,
            Refusal::Torque { .. } => fault == Fault::CommandStrong,
            Refusal::Kind { .. } => fault == Fault::CommandKind,
            Refusal::Old { .. } => fault == Fault::CommandOld,
            Refusal::Future { .. } => fault == Fault::CommandAhead,
            _ => false,
        };
        assert!(named, "{what}: {:?}", gate.admission().refusal());
        assert_eq!(gate.admission().refused(), refused + 1, "{what}");
        assert!(
            gate.admission().activation_latched() >= activation,
            "{what}"
        );
        assert_ne!(cell.given(), last, "{what}");
        cell.step();
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        if is_followed(offset) {
            cell.until("the task is over", |c| !c.phase().is_active());
            cell.assert_stands(&what, REST, 1500);
        }
    }
}

#[test]
fn a_second_source_is_refused_in_its_period_and_the_first_notices_nothing() {
    for offset in (0..OFFSETS).step_by(8) {
        let mut alone = Cell::sliding(());
        alone.steps(offset);
        let cells = (with(Fault::SecondSource, offset), alone);
        let refused = |cell: &Cell| {
            let lease = cell.gate().lease();
            if lease.refused() > 0 {
                let rival = lease.rival(cell.now_s()).unwrap();
                assert!(lease.refusal_of(rival).contains("drives this arm"));
            }
            lease.refused()
        };
        second_source_changes_nothing(cells, 100, refused, Cell::given);
    }
}

/// Answers of which the older one arrives last, and none in every second period.
#[test]
fn tolerated_faults_do_not_end_the_task() {
    for offset in (0..OFFSETS).step_by(8) {
        let mut cell = with(Fault::CommandSwapped, offset);
        cell.assert_slides_on(&format!("{offset}"), 1000);
        assert_eq!(cell.gate().admission().refused(), 0);
    }
}

/// The reported reason is the fault, not a tool that does not hang free.
#[test]
fn an_emergency_stop_while_the_tool_moves_off_ends_the_task() {
    let mut cell = Cell::in_phase((), Phase::Clear);
    cell.step();
    assert_eq!(cell.phase(), Phase::Clear);
    cell.trial.faults.push(Fault::EmergencyStop);
    cell.step();
    assert!(!cell.phase().is_active(), "{:?}", cell.phase());
    let why = cell.output.unwrap().fault;
    assert_eq!(why, Some(TaskFault::ArmNotReady));
}

#[test]
fn an_emergency_stop_ends_the_task_in_its_period() {
    for offset in 0..OFFSETS {
        let what = format!("{offset}");
        let mut cell = with(Fault::EmergencyStop, offset);
        let (last, activation) = (cell.given(), cell.activation());
        cell.step();
        assert!(
            cell.gate().admission().activation_latched() >= activation,
            "{what}"
        );
        assert_ne!(cell.given(), last, "{what}");
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let why = cell.output.unwrap().fault;
        assert_eq!(why, Some(TaskFault::ArmNotReady), "{what}");
        if is_followed(offset) {
            cell.until("the task is over", |c| !c.phase().is_active());
            cell.assert_stands(&what, REST, 1500);
        }
    }
}

/// The records of a period are available in the next. At one record per cycle, a first record that
/// is not a number is left out as a jump.
#[test]
fn a_bad_wrench_retracts_in_its_second_cycle() {
    let faults = [Fault::SensorSaturated, Fault::SensorError, Fault::SensorNan];
    for (fault, offset) in shared(faults) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let (decides, validity) = match fault {
            Fault::SensorSaturated => (2, Validity::Saturated),
            Fault::SensorError => (2, Validity::SensorError),
            _ => (3, Validity::NotFinite),
        };
        cell.step();
        cell.assert_retracts_for(&what, decides, validity);
        if is_followed(offset) {
            cell.assert_leaves_the_surface(&what);
        }
    }
}

/// At one record per cycle, whole records are detected within five, and a single axis as soon as
/// its own noise cannot repeat so often.
#[test]
fn an_implausible_sensor_retracts() {
    for (fault, offset) in shared([Fault::SensorFrozen, Fault::AxisStuck]) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let (most, validity) = match fault {
            Fault::SensorFrozen => (5, Validity::Frozen),
            _ => (AXIS_STUCK, Validity::AxisStuck),
        };
        cell.step();
        let mut cycles = 0;
        while cell.phase() == Phase::Slide {
            cell.step();
            cycles += 1;
        }
        assert!(cycles <= most, "{what}: {cycles} cycles");
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let why = cell.output.unwrap().fault;
        assert_eq!(why, Some(TaskFault::Wrench(validity)), "{what}");
        if is_followed(offset) {
            cell.assert_leaves_the_surface(&what);
        }
    }
}

#[test]
fn a_silent_wrench_stops_and_retracts_after_its_patience() {
    for (fault, offset) in shared([Fault::SensorSilent, Fault::SensorRestart]) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        cell.assert_stops_then_retracts(&what, 5..=6, WRENCH_RETRACT);
        if is_followed(offset) {
            cell.assert_leaves_the_surface(&what);
        }
    }
}

#[test]
fn without_an_estimate_the_path_stops_and_the_tool_retracts_after_a_second() {
    for offset in (0..OFFSETS).step_by(4) {
        let mut cell = with(Fault::EstimateSilent, offset);
        let begun = cell.trial.cycle;
        let mut stopped = None;
        while cell.phase() != Phase::Retract {
            cell.step();
            assert!(cell.trial.cycle < begun + 2 * ESTIMATE_RETRACT, "{offset}");
            if cell.phase() == Phase::Hold {
                let at = cell.output.unwrap().path_progress;
                let (_, stood) = *stopped.get_or_insert((cell.trial.cycle, at));
                assert_eq!(at, stood, "{offset}: the path goes on");
                let force_n = cell.truth().wrench.force.norm();
                let off = (force_n - cell.reference_n()).abs();
                assert!(off < 4.0, "{offset}: {force_n} N");
            }
        }
        let (since, _) = stopped.unwrap();
        let stops = since - begun;
        // The clock slows down from its present rate.
        let most = ESTIMATE + CLOCK + 2;
        assert!((ESTIMATE..=most).contains(&stops), "{offset}: {stops}");
        let retracts = cell.trial.cycle - begun;
        assert!(
            retracts.abs_diff(ESTIMATE + ESTIMATE_RETRACT) <= 2,
            "{offset}: {retracts}"
        );
        let why = cell.output.unwrap().fault;
        assert!(matches!(why, Some(TaskFault::Estimate(_))), "{why:?}");
        cell.assert_leaves_the_surface(&format!("{offset}"));
    }
}

/// Without frames, the estimate of the object's pose expires as without an estimate: touch alone
/// does not determine the pose.
#[test]
fn without_frames_the_tool_retracts() {
    for offset in (0..OFFSETS).step_by(6) {
        let mut cell = with(Fault::CameraDark, offset);
        let begun = cell.trial.cycle;
        cell.until("it retracts", |c| c.phase() == Phase::Retract);
        let retracts = cell.trial.cycle - begun;
        assert!(
            retracts <= ESTIMATE + ESTIMATE_RETRACT + 2,
            "{offset}: {retracts}"
        );
        let why = cell.output.unwrap().fault;
        assert!(matches!(why, Some(TaskFault::Estimate(_))), "{why:?}");
        cell.assert_leaves_the_surface(&format!("{offset}"));
    }
}

#[test]
fn a_lost_contact_is_sought_in_its_third_cycle() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::ContactLost, offset);
        cell.step();
        cell.assert_seeks_after(&format!("{offset}"), 3);
    }
}
