//! The failure table of docs/architecture.md as far as it is logic: robot program, bridge and
//! controller are stepped together in simulated time, with the fault in every cycle. The bounds are
//! met exactly, because no real machine is involved. `tangent faults` measures what a machine adds.

// Everything in this file is test code: a panic fails the test.
#![allow(clippy::unwrap_used)]

mod cell;
mod fault;
mod pairs;
#[path = "../table/mod.rs"]
mod table;

use cell::Cell;
use fault::Fault;
use tangent_control::{Fault as TaskFault, Phase};
use tangent_sensing::Validity;
use tangent_simulated_ur::Flavour;

use table::{TableCell, second_source_changes_nothing};

/// A fault begins in each of this many first cycles of the path.
const OFFSETS: u64 = 40;
/// Time in which the arm comes to rest after its program stopped it, s.
const REST_S: f64 = 0.4;
/// Timeout of the wrench in the default cell and law, cycles.
const WRENCH_SILENT_CYCLES: f64 = 2.0;
const WRENCH_JITTER_S: f64 = 0.004;
const WRENCH_RETRACT_S: f64 = 0.1;
const ESTIMATE_S: f64 = 0.1;
const ESTIMATE_RETRACT_S: f64 = 1.0;

/// Cycles in which both series are tested: every cycle at 125 Hz, and a selection at 500 Hz that
/// covers all phases of a cycle at 125 Hz.
fn both() -> impl Iterator<Item = (Flavour, u64)> {
    let cb3 = (0..OFFSETS).map(|offset| (Flavour::Cb3, offset));
    cb3.chain(
        (0..OFFSETS)
            .step_by(7)
            .map(|offset| (Flavour::ESeries, offset)),
    )
}

/// Every third cycle offset, starting with `of`: three faults with the same expected result share
/// the offsets.
fn every_third(of: usize) -> impl Iterator<Item = (Flavour, u64)> {
    both().filter(move |(_, offset)| *offset as usize % 3 == of)
}

/// Whether the end of the fault is tested too; that is done for some of the cycles.
fn is_followed(offset: u64) -> bool {
    offset % 8 == 3
}

/// The first cycle whose end is later than `limit_s` after a start, where each adds `period_s`.
fn first_beyond(limit_s: f64, period_s: f64) -> u64 {
    let (mut sum_s, mut cycles) = (0.0, 0);
    while sum_s <= limit_s {
        sum_s += period_s;
        cycles += 1;
    }
    cycles
}

/// Cycle in which an age exceeds `limit_s`, if it grows by one period per cycle. If the limit is a
/// whole number of periods, rounding decides whether it is the cycle before; `is_earlier` gives the
/// cell's result.
fn cycle_beyond(limit_s: f64, period_s: f64, is_earlier: bool) -> u64 {
    let cycles = limit_s / period_s;
    let whole = (cycles - cycles.round()).abs() < 1e-6;
    if whole {
        cycles.round() as u64 + u64::from(!is_earlier)
    } else {
        cycles.floor() as u64 + 1
    }
}

#[test]
fn the_program_holds_for_two_cycles_is_at_zero_in_the_fifth_and_stops() {
    for (flavour, held, zero) in [(Flavour::Cb3, 2, 5), (Flavour::ESeries, 8, 20)] {
        for (_, offset) in both().filter(|(at, _)| *at == flavour) {
            let mut cell = Cell::with(flavour, Fault::BridgeDead, offset);
            let before = cell.given();
            assert!(before.norm() > 0.0);
            for stale in 1..=zero {
                cell.step();
                let left = (f64::from(zero - stale) / f64::from(zero - held)).min(1.0);
                let off = (cell.given() - before * left).norm() / before.norm();
                // The program's text gives the step of the ramp with nine decimals.
                assert!(
                    off < 1e-8,
                    "{flavour:?}, {offset}, {stale}: {}",
                    cell.given()
                );
            }
            cell.step();
            assert_eq!(cell.program(), (3, 1), "{flavour:?}, {offset}");
            cell.steps((REST_S / cell.period_s()) as u64);
            assert_eq!(cell.program(), (4, 1), "{flavour:?}, {offset}");
            assert!(cell.robot_speed() < 1e-6);
            assert!(cell.trial.peak_n < 10.0, "{} N", cell.trial.peak_n);
        }
    }
}

#[test]
fn without_a_command_the_bridge_holds_for_two_cycles_and_ramps_in_the_third() {
    for (flavour, offset) in both() {
        let mut cell = Cell::with(flavour, Fault::NoCommand, offset);
        let last = cell.output.unwrap().qd;
        for _ in 0..2 {
            cell.step();
            assert_eq!(*cell.bridge().gate().qd(), last, "{offset}");
        }
        let mut before = last.norm();
        while before > 0.0 {
            cell.step();
            let now = cell.bridge().gate().qd().norm();
            assert!(now < before, "{offset}: {now} after {before}");
            before = now;
        }
        let gate = cell.bridge().gate();
        assert!(
            gate.admission.missed() >= 3,
            "{offset}: {}",
            gate.admission.missed()
        );
        // A silence of 0.1 s ends the task.
        cell.steps((0.16 / cell.period_s()) as u64);
        assert!(
            cell.bridge().gate().admission.activation_latched() > 0,
            "{offset}"
        );
    }
}

#[test]
fn a_bad_command_is_refused_and_ramped_down_from_in_its_cycle() {
    for (i, fault) in [Fault::CommandNan, Fault::CommandFast]
        .into_iter()
        .enumerate()
    {
        for (flavour, offset) in every_third(i) {
            let mut cell = Cell::with(flavour, fault, offset);
            let (last, refused) = (
                cell.bridge().gate().qd().norm(),
                cell.bridge().gate().admission.refused(),
            );
            cell.step();
            let gate = cell.bridge().gate();
            assert_eq!(gate.admission.refused(), refused + 1, "{fault:?}, {offset}");
            assert!(gate.qd().norm() < last, "{fault:?}, {offset}");
        }
    }
}

#[test]
fn an_old_command_is_refused_in_its_cycle_and_counts_as_none() {
    for (flavour, offset) in both() {
        let mut cell = Cell::with(flavour, Fault::CommandOld, offset);
        let mut last = *cell.bridge().gate().qd();
        for silent in 1..=3 {
            let refused = cell.bridge().gate().admission.refused();
            cell.step();
            let gate = cell.bridge().gate();
            assert_eq!(gate.admission.refused(), refused + 1, "{offset}");
            assert_eq!(
                gate.qd().norm() < last.norm(),
                silent > 2,
                "{offset}, {silent}"
            );
            last = *gate.qd();
        }
    }
}

#[test]
fn a_second_source_is_refused_in_its_cycle_and_the_first_notices_nothing() {
    for offset in (0..OFFSETS).step_by(5) {
        let mut alone = Cell::sliding(Flavour::Cb3);
        alone.steps(offset);
        let cells = (Cell::with(Flavour::Cb3, Fault::SecondSource, offset), alone);
        let refused = |cell: &Cell| cell.bridge().lease().refused();
        let cell = second_source_changes_nothing(cells, 50, refused, Cell::given);
        let rival = cell.bridge().lease().rival(cell.now_s()).unwrap();
        assert_eq!(rival.to_string(), "controller/other-2");
    }
}

#[test]
fn a_bad_wrench_retracts_in_its_second_cycle() {
    let faults = [
        (Fault::SensorNan, Validity::NotFinite),
        (Fault::SensorSaturated, Validity::Saturated),
        (Fault::SensorError, Validity::SensorError),
    ];
    for (i, (fault, validity)) in faults.into_iter().enumerate() {
        for (flavour, offset) in every_third(i) {
            let what = format!("{fault:?}, {flavour:?}, {offset}");
            let mut cell = Cell::with(flavour, fault, offset);
            cell.assert_retracts_for(&what, 2, validity);
            if is_followed(offset) {
                off_the_surface(&mut cell);
            }
        }
    }
}

/// Records that repeat, repeat on one axis, or come from a disconnected transducer: at 1 kHz there
/// are 8 of them in a cycle at 125 Hz, and 2 at 500 Hz.
#[test]
fn an_implausible_sensor_retracts_within_two_cycles() {
    let faults = [
        (Fault::SensorFrozen, Validity::Frozen),
        (Fault::SensorDead, Validity::Frozen),
        (Fault::AxisStuck, Validity::AxisStuck),
    ];
    for (i, (fault, validity)) in faults.into_iter().enumerate() {
        for (flavour, offset) in every_third(i) {
            let what = format!("{fault:?}, {flavour:?}, {offset}");
            let mut cell = Cell::with(flavour, fault, offset);
            // One axis may repeat by chance in more records than all of them, and the first record
            // of a dead transducer does not repeat the last one.
            let decides = match (flavour, fault) {
                (Flavour::ESeries, Fault::AxisStuck | Fault::SensorDead) => 2,
                _ => 1,
            };
            // Two records come in a cycle of 2 ms: the one that decides may just miss the second.
            let latest = match (flavour, fault) {
                (Flavour::ESeries, Fault::AxisStuck) => 3,
                _ => decides,
            };
            cell.assert_retracts_within(&what, decides..=latest, validity);
            if is_followed(offset) {
                off_the_surface(&mut cell);
            }
        }
    }
}

/// One record in four is wrong: the seventh wrong one, with the 28th record, exceeds the limit.
#[test]
fn records_that_leap_are_left_out_until_they_are_too_many() {
    for (flavour, offset) in both() {
        let what = format!("{flavour:?}, {offset}");
        let mut cell = Cell::with(flavour, Fault::SensorCorrupt, offset);
        let decides = (28.0 * 0.001 / cell.period_s()).ceil() as u64;
        for cycle in 1..=decides {
            assert_eq!(cell.phase(), Phase::Slide, "{what}, {cycle}");
            let truth = cell.truth();
            let off_n = cell.output.unwrap().force_n.unwrap() - truth.wrench.force.norm();
            assert!(off_n.abs() < 0.5, "{what}, {cycle}: shown {off_n} N off");
            cell.step();
        }
        assert_eq!(cell.phase(), Phase::Retract, "{what}");
        let why = cell.output.unwrap().fault;
        assert_eq!(
            why,
            Some(TaskFault::Wrench(Validity::Implausible)),
            "{what}"
        );
        if is_followed(offset) {
            off_the_surface(&mut cell);
        }
    }
}

/// The tool lifts off to prove the zero, which is then refused: 20 ms after the jump the watch has
/// seen enough.
#[test]
fn a_zero_that_jumps_takes_the_tool_off_the_surface_and_ends_the_task() {
    for (flavour, offset) in both() {
        let what = format!("{flavour:?}, {offset}");
        let mut cell = Cell::with(flavour, Fault::ZeroJumped, offset);
        let latest = (0.022 / cell.period_s()).ceil() as u64 + 1;
        let cycle = (1..=latest).find(|_| {
            cell.step();
            cell.phase() != Phase::Slide
        });
        assert!(
            cycle.is_some(),
            "{what}: still slides after {latest} cycles"
        );
        assert!(
            matches!(cell.phase(), Phase::Clear | Phase::Retract),
            "{what}"
        );
        if is_followed(offset) {
            off_the_surface(&mut cell);
            let why = cell.output.unwrap().fault;
            assert_eq!(why, Some(TaskFault::Wrench(Validity::ZeroJumped)), "{what}");
        }
    }
}

/// The robot's own stops, and its restart: the task ends with the first packet that reports them,
/// and nothing moves before a new start.
#[test]
fn a_robot_that_stops_by_itself_ends_the_task_in_that_cycle() {
    for fault in [
        Fault::ProtectiveStop,
        Fault::EmergencyStop,
        Fault::RobotRestart,
    ] {
        for (flavour, offset) in both().filter(|(_, offset)| is_followed(*offset)) {
            let what = format!("{fault:?}, {flavour:?}, {offset}");
            let mut cell = Cell::with(flavour, fault, offset);
            let activation = cell.output.unwrap().activation;
            cell.step();
            if fault == Fault::RobotRestart {
                // No packet arrives, and the bridge has closed.
                assert_eq!(cell.phase(), Phase::Slide, "{what}");
                cell.steps(20);
                cell.trial.faults.clear();
                cell.until("a packet comes", |c| c.phase() != Phase::Slide);
            }
            assert_eq!(cell.phase(), Phase::Fault, "{what}");
            assert_eq!(
                cell.output.unwrap().fault,
                Some(TaskFault::ArmNotReady),
                "{what}"
            );
            cell.steps((REST_S / cell.period_s()) as u64);
            assert!(cell.robot_speed() < 1e-6, "{what}");
            cell.trial.faults.clear();
            cell.until("the robot is there again", |c| {
                if !c.bridge().is_ready() {
                    return false;
                }
                assert!(c.robot_speed() < 1e-6);
                true
            });
            assert!(
                cell.bridge().gate().admission.activation_latched() >= activation,
                "{what}"
            );
            cell.steps(100);
            assert!(cell.robot_speed() < 1e-6, "{what}");
            assert!(cell.trial.peak_n < 10.0, "{what}: {} N", cell.trial.peak_n);
        }
    }
}

/// The tool retracts along the normal and stops; returns the largest force.
fn off_the_surface(cell: &mut Cell) {
    cell.until("it has left", |c| c.phase() == Phase::Fault);
    let truth = cell.truth();
    assert_eq!(truth.wrench.force.norm(), 0.0);
    assert!(cell.trial.peak_n < 10.0, "{} N", cell.trial.peak_n);
    cell.until("it rests", |c| c.robot_speed() < 1e-6);
}

/// An input that is silent for `silent_s` stops the path in the cycle that detects it, and
/// `patience_s` later the tool retracts. `during` checks each cycle before that, given its number
/// and that of the stop. Returns the latest cycle of the stop.
fn stops_then_retracts(
    cell: &mut Cell,
    silent_s: f64,
    patience_s: f64,
    what: &str,
    during: impl Fn(&Cell, u64, u64),
) -> u64 {
    let period_s = cell.period_s();
    let (early, late) = (
        cycle_beyond(silent_s, period_s, true),
        cycle_beyond(silent_s, period_s, false),
    );
    let mut stops = u64::MAX;
    for cycle in 1.. {
        cell.step();
        if cycle <= late && stops > cycle && cell.phase() == Phase::Hold {
            stops = cycle;
        }
        let retracts = stops.saturating_add(first_beyond(patience_s, period_s) - 1);
        let expected = match cycle {
            _ if cycle >= retracts => Phase::Retract,
            _ if cycle >= stops => Phase::Hold,
            _ => Phase::Slide,
        };
        assert_eq!(cell.phase(), expected, "{what}, cycle {cycle}");
        assert!(cycle < late || stops <= cycle, "{what}: does not stop");
        if cycle == retracts {
            break;
        }
        during(cell, cycle, stops);
    }
    assert!((early..=late).contains(&stops), "{what}: {stops}");
    late
}

#[test]
fn a_silent_wrench_stops_after_two_cycles_and_retracts_after_its_patience() {
    for (i, fault) in [Fault::SensorSilent, Fault::SensorRestart]
        .into_iter()
        .enumerate()
    {
        for (flavour, offset) in every_third(i) {
            let what = format!("{fault:?}, {flavour:?}, {offset}");
            let mut cell = Cell::with(flavour, fault, offset);
            let period_s = cell.period_s();
            // The filter delays the newest record: at a packet, it is the last one of the period
            // that ended.
            let silent_s = WRENCH_SILENT_CYCLES * period_s + WRENCH_JITTER_S;
            let late =
                stops_then_retracts(&mut cell, silent_s, WRENCH_RETRACT_S, &what, |_, _, _| {});
            // Two cycles are tolerated, plus the sensor's own jitter.
            assert_eq!(
                late,
                match flavour {
                    Flavour::Cb3 => 3,
                    Flavour::ESeries => 5,
                }
            );
            if is_followed(offset) {
                off_the_surface(&mut cell);
            }
        }
    }
}

#[test]
fn without_an_estimate_the_path_stops_after_its_patience_and_the_tool_retracts_after_a_second() {
    for (flavour, offset) in both().filter(|(_, offset)| offset % 3 == 0) {
        let mut cell = Cell::with(flavour, Fault::EstimateSilent, offset);
        let period_s = cell.period_s();
        let what = format!("{flavour:?}, {offset}");
        // An estimate is computed from the packet before.
        let kept = |cell: &Cell, cycle: u64, stops: u64| {
            // The force is kept while the path is stopped.
            if cycle > stops.saturating_add((0.32 / period_s) as u64) {
                let force_n = cell.truth().wrench.force.norm();
                assert!((force_n - 3.0).abs() < 0.5, "{what}, {cycle}: {force_n} N");
            }
        };
        stops_then_retracts(&mut cell, ESTIMATE_S, ESTIMATE_RETRACT_S, &what, kept);
        off_the_surface(&mut cell);
    }
}

#[test]
fn a_lost_contact_is_sought_after_24_ms() {
    for (flavour, offset) in both() {
        let mut cell = Cell::with(flavour, Fault::ContactLost, offset);
        let cycles = (0.024 / cell.period_s()).round() as u64;
        let progress = cell.assert_seeks_after(&format!("{flavour:?}, {offset}"), cycles);
        // In its first cycle the path starts from rest.
        let gone_s = (cell.output.unwrap().path_progress - progress) * cell.path_s();
        assert!(
            (0.0..cell.period_s()).contains(&gone_s),
            "{offset}: {gone_s} s"
        );
        assert!(cell.trial.peak_n < 10.0, "{} N", cell.trial.peak_n);
    }
}
