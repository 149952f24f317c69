//! The failure table of docs/architecture.md where it is logic: robot program, bridge and controller stepped together in simulated time,
//! with the fault in every cycle. The bounds are met exactly: no machine is in it. What a machine adds is what `tangent faults` measures.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

mod cell;
mod pairs;

use cell::{Cell, Fault};
use tangent_control::{Fault as TaskFault, Phase};
use tangent_sensing::Validity;
use tangent_simulator::Flavour;

/// Faults come in each of the path's first cycles.
const OFFSETS: u64 = 40;
/// In this time the arm has come to rest after its program stopped it, s.
const REST_S: f64 = 0.4;
/// Of the default cell and law.
const WRENCH_SILENT_S: f64 = 2.0 * 0.008 + 0.004;
const WRENCH_RETRACT_S: f64 = 0.1;
const ESTIMATE_S: f64 = 0.1;
const ESTIMATE_RETRACT_S: f64 = 1.0;

/// Sliding, and from the next cycle on with `fault`.
fn with(fault: Fault, flavour: Flavour, offset: u64) -> Cell {
    let mut cell = Cell::sliding(flavour);
    cell.steps(offset);
    assert_eq!(cell.phase(), Phase::Slide);
    cell.faults = vec![fault];
    cell
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

#[test]
fn the_program_holds_for_two_cycles_is_at_zero_in_the_fifth_and_stops() {
    for (flavour, held, zero) in [(Flavour::Cb3, 2, 5), (Flavour::ESeries, 8, 20)] {
        for offset in 0..OFFSETS {
            let mut cell = with(Fault::BridgeDead, flavour, offset);
            let before = cell.given();
            assert!(before.norm() > 0.0);
            for stale in 1..=zero {
                cell.step();
                let left = (f64::from(zero - stale) / f64::from(zero - held)).min(1.0);
                let off = (cell.given() - before * left).norm() / before.norm();
                // The program's text gives the ramp's step with nine decimals.
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
            assert!(cell.peak_n < 10.0, "{} N", cell.peak_n);
        }
    }
}

#[test]
fn without_a_command_the_bridge_holds_for_two_cycles_and_ramps_in_the_third() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::NoCommand, Flavour::Cb3, offset);
        let last = cell.output.unwrap().qd;
        for _ in 0..2 {
            cell.step();
            assert_eq!(*cell.bridge().guard().qd(), last, "{offset}");
        }
        let mut before = last.norm();
        while before > 0.0 {
            cell.step();
            let now = cell.bridge().guard().qd().norm();
            assert!(now < before, "{offset}: {now} after {before}");
            before = now;
        }
        let guard = cell.bridge().guard();
        assert!(guard.missed() >= 3, "{offset}: {}", guard.missed());
        // 0.1 s of silence end the task.
        cell.steps(20);
        assert!(cell.bridge().guard().activation_latched() > 0, "{offset}");
    }
}

#[test]
fn a_bad_command_is_refused_and_ramped_down_from_in_its_cycle() {
    for fault in [Fault::CommandNan, Fault::CommandFast] {
        for offset in 0..OFFSETS {
            let mut cell = with(fault, Flavour::Cb3, offset);
            let (last, refused) = (
                cell.bridge().guard().qd().norm(),
                cell.bridge().guard().refused(),
            );
            cell.step();
            let guard = cell.bridge().guard();
            assert_eq!(guard.refused(), refused + 1, "{fault:?}, {offset}");
            assert!(guard.qd().norm() < last, "{fault:?}, {offset}");
        }
    }
}

#[test]
fn an_old_command_is_refused_in_its_cycle_and_counts_as_none() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::CommandOld, Flavour::Cb3, offset);
        let mut last = *cell.bridge().guard().qd();
        for silent in 1..=3 {
            let refused = cell.bridge().guard().refused();
            cell.step();
            let guard = cell.bridge().guard();
            assert_eq!(guard.refused(), refused + 1, "{offset}");
            assert_eq!(
                guard.qd().norm() < last.norm(),
                silent > 2,
                "{offset}, {silent}"
            );
            last = *guard.qd();
        }
    }
}

#[test]
fn a_second_source_is_refused_in_its_cycle_and_the_first_notices_nothing() {
    for offset in (0..OFFSETS).step_by(5) {
        let mut cell = with(Fault::SecondSource, Flavour::Cb3, offset);
        let mut alone = Cell::sliding(Flavour::Cb3);
        alone.steps(offset);
        for cycle in 1..=50 {
            cell.step();
            alone.step();
            assert_eq!(cell.bridge().lease().refused(), cycle);
            assert_eq!(cell.given(), alone.given(), "{offset}, {cycle}");
        }
        let rival = cell.bridge().lease().rival(cell.now_s()).unwrap();
        assert_eq!(rival.to_string(), "controller/other-2");
    }
}

#[test]
fn a_bad_wrench_retracts_in_its_second_cycle() {
    for (fault, validity) in [
        (Fault::SensorNan, Validity::NotFinite),
        (Fault::SensorSaturated, Validity::Saturated),
        (Fault::SensorError, Validity::SensorError),
    ] {
        for offset in 0..OFFSETS {
            let mut cell = with(fault, Flavour::Cb3, offset);
            cell.step();
            assert_eq!(cell.phase(), Phase::Slide, "{fault:?}, {offset}");
            cell.step();
            assert_eq!(cell.phase(), Phase::Retract, "{fault:?}, {offset}");
            let why = cell.output.unwrap().fault;
            assert_eq!(why, Some(TaskFault::Wrench(validity)), "{offset}");
            off_the_surface(&mut cell);
        }
    }
}

/// It retracts along the normal and stands; how hard it pressed at most.
fn off_the_surface(cell: &mut Cell) {
    cell.until("it has left", |c| c.phase() == Phase::Fault);
    let truth = cell.truth();
    assert_eq!(truth.wrench.force.norm(), 0.0);
    assert!(cell.peak_n < 10.0, "{} N", cell.peak_n);
    cell.until("it rests", |c| c.robot_speed() < 1e-6);
}

#[test]
fn a_silent_wrench_stops_after_two_cycles_and_retracts_after_its_patience() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::SensorSilent, Flavour::Cb3, offset);
        let period_s = cell.period_s();
        // The newest record is as old as its filter's neighbours make it: at a packet, the last of the period that ended.
        let stops = (WRENCH_SILENT_S / period_s).floor() as u64 + 1;
        let retracts = stops - 1 + first_beyond(WRENCH_RETRACT_S, period_s);
        for cycle in 1..=retracts {
            cell.step();
            let expected = match cycle {
                _ if cycle == retracts => Phase::Retract,
                _ if cycle >= stops => Phase::Hold,
                _ => Phase::Slide,
            };
            assert_eq!(cell.phase(), expected, "{offset}, cycle {cycle}");
        }
        assert_eq!(stops, 3, "two cycles are borne");
        off_the_surface(&mut cell);
    }
}

#[test]
fn without_an_estimate_the_path_stops_after_its_patience_and_the_tool_retracts_after_a_second() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::EstimateSilent, Flavour::Cb3, offset);
        let period_s = cell.period_s();
        // An estimate is made of the packet before.
        let stops = (ESTIMATE_S / period_s).floor() as u64 + 1;
        let retracts = stops - 1 + first_beyond(ESTIMATE_RETRACT_S, period_s);
        for cycle in 1..=retracts {
            cell.step();
            let expected = match cycle {
                _ if cycle == retracts => Phase::Retract,
                _ if cycle >= stops => Phase::Hold,
                _ => Phase::Slide,
            };
            assert_eq!(cell.phase(), expected, "{offset}, cycle {cycle}");
            // The force is kept while the path stands.
            if cycle > stops + 40 && cycle < retracts {
                let force_n = cell.truth().wrench.force.norm();
                assert!(
                    (force_n - 3.0).abs() < 0.5,
                    "{offset}, {cycle}: {force_n} N"
                );
            }
        }
        off_the_surface(&mut cell);
    }
}

#[test]
fn a_lost_contact_is_sought_in_its_third_cycle() {
    for offset in 0..OFFSETS {
        let mut cell = with(Fault::ContactLost, Flavour::Cb3, offset);
        for cycle in 1..=3 {
            cell.step();
            let expected = if cycle < 3 { Phase::Slide } else { Phase::Seek };
            assert_eq!(cell.phase(), expected, "{offset}, cycle {cycle}");
        }
        let progress = cell.output.unwrap().path_progress;
        // It is felt again: the path goes on from where it stood.
        cell.faults.clear();
        cell.until("it slides again", |c| {
            let slides = c.phase() == Phase::Slide;
            if !slides {
                assert_eq!(c.output.unwrap().path_progress, progress, "{offset}");
            }
            slides
        });
        // In its first cycle it starts from rest.
        let gone_s = (cell.output.unwrap().path_progress - progress) * cell.path_s();
        assert!(
            (0.0..cell.period_s()).contains(&gone_s),
            "{offset}: {gone_s} s"
        );
        assert!(cell.peak_n < 10.0, "{} N", cell.peak_n);
    }
}
