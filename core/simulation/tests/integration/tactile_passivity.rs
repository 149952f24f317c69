//! Passivity of `unified_force_impedance` at the port to the environment: the guarantee of its
//! tanks in any world, and every world in which it once failed.

// The test prints its results, and reads the scenarios of the repository.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
// A whole file of tests: what fails here is the test.
use std::cell::{Cell, RefCell};

use crate::any_world::{Rough, World, anything};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{TestRunner, contextualize_config};

/// The tool slides off the block, sinks beside it and comes back through its side.
#[test]
fn a_tool_that_slid_off_the_block_comes_back() {
    let world = World {
        stiffness_n_per_m: 173_194.560554794,
        friction: 0.3930490776846641,
        force_n: 3.0,
        radius_m: 0.01,
        turn_rate_rad_per_s: 0.0,
        rough: Rough {
            force_n: [-7.722791544915974, -10.674017852338778, -14.9305791589723],
            moment_nm: [0.0; 3],
            push_rad_per_s: 0.5,
            view_rad: [0.0, -0.20282331080815375],
        },
        tanks_j: [1.5, 1.2],
        paper: false,
        seed: 0,
    };
    let mut peak_n = 0.0_f64;
    let played = world.play(|c| peak_n = peak_n.max(c.truth.wrench.force.norm()));
    assert!(played.slid, "{:?}", played.fault);
    played.judge().unwrap();
    assert!(peak_n < 500.0, "{peak_n} N");
}

/// High above the block's wave, beyond its focal distance, the plant once found the surface beside
/// the tool and pushed with kilonewtons.
#[test]
fn a_tool_high_above_the_wave_touches_nothing() {
    let world = World {
        stiffness_n_per_m: 99_892.24299019044,
        friction: 0.24567289028142517,
        force_n: 4.917214535711755,
        radius_m: 0.051687803984372456,
        turn_rate_rad_per_s: -1.8504810437037658,
        rough: Rough {
            force_n: [8.0988505631995, -13.288595249277874, -10.214503081564281],
            moment_nm: [0.4597871450084636, 1.944679181152607, 0.8930379619566957],
            push_rad_per_s: 1.798769673293664,
            view_rad: [-0.09635032817932404, 0.28639299835943377],
        },
        tanks_j: [18.513529602713927, 1.942941208812488],
        paper: false,
        seed: 728,
    };
    let mut peak_n = 0.0_f64;
    let played = world.play(|c| peak_n = peak_n.max(c.truth.wrench.force.norm()));
    assert!(played.slid, "{:?}", played.fault);
    played.judge().unwrap();
    assert!(peak_n < 500.0, "{peak_n} N");
}

const CASES: u32 = 24;

#[test]
fn the_port_is_passive_whatever_the_world_and_the_policy() {
    let (played, slid) = (Cell::new(0_u32), Cell::new(0_u32));
    let others = RefCell::new(Vec::new());
    // PROPTEST_CASES sets their number, PROPTEST_RNG_SEED selects others: see .ci/search.
    let mut runner = TestRunner::new(contextualize_config(ProptestConfig {
        cases: CASES,
        failure_persistence: None,
        ..ProptestConfig::default()
    }));
    runner
        .run(&anything(), |world| {
            let run = world.play(|_| ());
            played.set(played.get() + 1);
            slid.set(slid.get() + u32::from(run.slid));
            if !run.slid {
                others.borrow_mut().push(run.fault);
            }
            run.judge().map_err(TestCaseError::fail)
        })
        .unwrap();
    assert!(
        slid.get() * 2 > played.get(),
        "only {} of {} slid, the others: {:?}",
        slid.get(),
        played.get(),
        others.borrow()
    );
}

/// Runs PROPTEST_CASES worlds and prints the reason for each failure: for a search, not for regular
/// test runs.
#[test]
#[ignore = "a search: .ci/search passivity"]
fn every_world_that_breaks_the_promise_is_listed() {
    let cases = contextualize_config(ProptestConfig::default()).cases;
    let mut runner = TestRunner::new(contextualize_config(ProptestConfig::default()));
    let (mut bad, mut slid) = (0, 0);
    for case in 0..cases {
        let world = anything().new_tree(&mut runner).unwrap().current();
        let run = world.play(|_| ());
        slid += u32::from(run.slid);
        if let Err(why) = run.judge() {
            bad += 1;
            println!(
                "case {case}: {why}; joints at {:.1} of their speed: {world:?}",
                run.speed_share
            );
        }
        if (case + 1) % 100 == 0 {
            println!("{} worlds, {slid} slid, {bad} bad", case + 1);
        }
    }
    assert_eq!(bad, 0, "of {cases}");
}
