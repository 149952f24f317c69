//! The failure table of docs/architecture.md for an arm that takes torques from `hybrid_dynamics`:
//! arm, object, sensor and camera, the gate before the motors and the law stepped together at 1 kHz
//! in simulated time. The bounds are met exactly: no machine is in it.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

mod cell;
mod fault;
mod pairs;

use cell::Cell;
use fault::Fault;
use tangent_actuation::Refusal;
use tangent_control::{Fault as TaskFault, Phase};
use tangent_sensing::Validity;

/// Faults come in each of the path's first cycles.
const OFFSETS: u64 = 24;
/// Silence after which a task is latched out, cycles.
const LATCHED: u64 = 101;
/// Longest that an axis stands still by the noise of this sensor, whose normal axis has a
/// resolution of 0.05 N, cycles.
const AXIS_STUCK: u64 = 60;
/// Patience with a silent wrench after the stop, cycles.
const WRENCH_RETRACT: u64 = 100;
/// Cycles without an estimate until the path's clock is slowed down, until it stands then, and
/// until the tool retracts.
const ESTIMATE: u64 = 100;
const CLOCK: u64 = 200;
const ESTIMATE_RETRACT: u64 = 1000;
/// In this time the arm has come to rest after its task was ended, cycles.
const REST: u64 = 300;
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
    offset % 8 < 4
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
    cell.steps(1500);
    assert!(!cell.phase().is_active(), "{what}: {:?}", cell.phase());
    assert!(cell.robot_speed() < AT_REST, "{what}: moves again");
    let most_n = most_n(cell);
    assert!(cell.peak_n <= most_n, "{what}: {} N", cell.peak_n);
}

/// The last torques stay for two periods, in the third the arm brakes.
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
            stands(&mut cell, &what);
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
        assert!(named, "{what}: {:?}", gate.reason());
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
            stands(&mut cell, &what);
        }
    }
}

#[test]
fn a_second_source_is_refused_in_its_period_and_the_first_notices_nothing() {
    for offset in (0..OFFSETS).step_by(8) {
        let mut cell = with(Fault::SecondSource, offset);
        let mut alone = Cell::sliding();
        alone.steps(offset);
        for cycle in 1..=100 {
            cell.step();
            alone.step();
            assert_eq!(cell.gate().lease().refused(), cycle);
            assert!(cell.gate().reason().contains("drives this arm"));
            assert_eq!(cell.given(), alone.given(), "{offset}, {cycle}");
        }
    }
}

/// Answers of which the older comes last, and none in every second period.
#[test]
fn what_is_borne_is_borne() {
    for offset in (0..OFFSETS).step_by(8) {
        let mut cell = with(Fault::CommandSwapped, offset);
        for cycle in 1..=1000 {
            cell.step();
            assert_eq!(cell.phase(), Phase::Slide, "{offset}, {cycle}");
        }
        assert_eq!(cell.gate().admission().refused(), 0);
        assert!(cell.peak_n <= most_n(&cell), "{} N", cell.peak_n);
    }
}

/// It says so, and not that the tool were not free.
#[test]
fn an_emergency_stop_while_the_tool_moves_off_ends_the_task() {
    let mut cell = Cell::in_phase(Phase::Clear);
    cell.step();
    assert_eq!(cell.phase(), Phase::Clear);
    cell.faults.push(Fault::EmergencyStop);
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
            stands(&mut cell, &what);
        }
    }
}

/// The records of a period are there in the next. At one record per cycle, a first one that is no
/// number is left out as a leap.
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

/// At one record per cycle: whole records within five, one axis as soon as its own noise cannot
/// repeat so often.
#[test]
fn a_sensor_that_does_not_live_retracts() {
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
            off_the_surface(&mut cell, &what);
        }
    }
}

#[test]
fn a_silent_wrench_stops_and_retracts_after_its_patience() {
    for (fault, offset) in shared([Fault::SensorSilent, Fault::SensorRestart]) {
        let what = format!("{fault:?}, {offset}");
        let mut cell = with(fault, offset);
        let mut stops = 0_u64;
        while cell.phase() == Phase::Slide {
            cell.step();
            stops += 1;
        }
        assert_eq!(cell.phase(), Phase::Hold, "{what}");
        // An age of just the limit is decided by rounding.
        assert!((5..=6).contains(&stops), "{what}: {stops}");
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
fn without_an_estimate_the_path_stops_and_the_tool_retracts_after_a_second() {
    for offset in (0..OFFSETS).step_by(4) {
        let mut cell = with(Fault::EstimateSilent, offset);
        let begun = cell.cycle;
        let mut stopped = None;
        while cell.phase() != Phase::Retract {
            cell.step();
            assert!(cell.cycle < begun + 2 * ESTIMATE_RETRACT, "{offset}");
            if cell.phase() == Phase::Hold {
                let at = cell.output.unwrap().path_progress;
                let (_, stood) = *stopped.get_or_insert((cell.cycle, at));
                assert_eq!(at, stood, "{offset}: the path goes on");
                let force_n = cell.truth().wrench.force.norm();
                let off = (force_n - cell.reference_n()).abs();
                assert!(off < 4.0, "{offset}: {force_n} N");
            }
        }
        let (since, _) = stopped.unwrap();
        let stops = since - begun;
        // The clock slows down from the rate that it has come to.
        let most = ESTIMATE + CLOCK + 2;
        assert!((ESTIMATE..=most).contains(&stops), "{offset}: {stops}");
        let retracts = cell.cycle - begun;
        assert!(
            retracts.abs_diff(ESTIMATE + ESTIMATE_RETRACT) <= 2,
            "{offset}: {retracts}"
        );
        let why = cell.output.unwrap().fault;
        assert!(matches!(why, Some(TaskFault::Estimate(_))), "{why:?}");
        off_the_surface(&mut cell, &format!("{offset}"));
    }
}

/// Its pose of the object grows old without frames, as without an estimate: touch alone does not
/// tell it.
#[test]
fn without_frames_the_tool_retracts() {
    for offset in (0..OFFSETS).step_by(6) {
        let mut cell = with(Fault::CameraDark, offset);
        let begun = cell.cycle;
        cell.until("it retracts", |c| c.phase() == Phase::Retract);
        let retracts = cell.cycle - begun;
        assert!(
            retracts <= ESTIMATE + ESTIMATE_RETRACT + 2,
            "{offset}: {retracts}"
        );
        let why = cell.output.unwrap().fault;
        assert!(matches!(why, Some(TaskFault::Estimate(_))), "{why:?}");
        off_the_surface(&mut cell, &format!("{offset}"));
    }
}

#[test]
fn a_lost_contact_is_sought_in_its_third_cycle() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::ContactLost, offset);
        cell.step();
        for cycle in 1..=3 {
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
