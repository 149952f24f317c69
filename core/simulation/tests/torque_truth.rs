//! The force shown is the true force, under the laws of the arms that take torques: a start while the tool presses moves off first.

// A test says what it found, and reads the scenarios that ship.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

mod tactile_cells;

use tangent_control::{Clearance, Fault, Phase};
use tangent_simulation::{Calm, ObjectLoop, ObjectScenario, TactileLoop, Undisturbed};

/// Largest difference between the mean force shown and the mean true one while it slides, N.
const SHOWN_MAX_N: f64 = 0.5;

/// What one period came to: phase, fault, force shown and true force along the normal, N.
#[derive(Clone, Copy, Debug)]
struct Seen {
    phase: Phase,
    fault: Option<Fault>,
    shown_n: Option<f64>,
    true_n: f64,
}

/// Steps until `wanted`, then for `more_s`; the phases on the way, the largest true force, and the mean difference while it slid.
fn run_until(
    mut step: impl FnMut() -> Seen,
    period_s: f64,
    wanted: Phase,
    more_s: f64,
) -> (Vec<Phase>, f64, f64) {
    let (mut phases, mut peak_n) = (Vec::new(), 0.0_f64);
    let (mut sum_n, mut count) = (0.0, 0.0);
    let mut after = None;
    for period in 0..(60.0 / period_s) as usize {
        let seen = step();
        if phases.last() != Some(&seen.phase) {
            phases.push(seen.phase);
        }
        peak_n = peak_n.max(seen.true_n);
        if seen.phase == wanted {
            after.get_or_insert(period);
        }
        if let Some(since) = after {
            let gone_s = (period - since) as f64 * period_s;
            if gone_s > 0.5 * more_s {
                sum_n += seen.shown_n.unwrap() - seen.true_n;
                count += 1.0;
            }
            if gone_s >= more_s {
                return (phases, peak_n, sum_n / count);
            }
        }
        assert!(
            seen.phase == wanted || seen.phase != Phase::Fault,
            "{phases:?} {:?}",
            seen.fault
        );
    }
    panic!("never in {wanted:?}: {phases:?}");
}

#[test]
fn unified_force_impedance_moves_off_before_it_takes_its_zero() {
    let scenario = tactile_cells::scenario(&[]);
    let reference_n = scenario.task.force.reference_n;
    let mut cell = TactileLoop::new(&scenario).unwrap();
    let period_s = cell.plant().period_s();
    let mut worst = 0.0_f64;
    for start in 0..3 {
        let step = || {
            let mut seen = None;
            cell.step(&mut Calm, &mut |c| {
                seen = Some(Seen {
                    phase: c.output.phase,
                    fault: c.output.fault,
                    shown_n: c.output.force_n,
                    true_n: c.truth.wrench.force.dot(&c.truth.normal),
                });
            });
            seen.unwrap()
        };
        let (phases, peak_n, off_n) = run_until(step, period_s, Phase::Slide, 3.0);
        assert_eq!(phases.contains(&Phase::Clear), start > 0, "{phases:?}");
        assert!(peak_n <= (2.0 * reference_n).max(10.0), "{peak_n} N");
        worst = worst.max(off_n.abs());
        // Killed while it presses: the next one knows where.
        let known = cell.controller().clearance();
        assert!(matches!(known, Clearance::Possible { .. }), "{known:?}");
        cell.controller().begin(known);
    }
    eprintln!("shown off by {worst:.3} N");
    assert!(worst <= SHOWN_MAX_N, "{worst} N");
}

#[test]
fn hybrid_dynamics_moves_off_before_the_tare() {
    let text = include_str!("../../../scenarios/lippiello/lippiello_realistic.toml");
    let scenario = ObjectScenario::parse("truth", text, &[]).unwrap();
    let reference_n = scenario.task.force.reference_n;
    let mut cell = ObjectLoop::new(&scenario).unwrap();
    let period_s = cell.plant().period_s();
    let mut worst = 0.0_f64;
    for start in 0..3 {
        let step = || {
            let mut seen = None;
            cell.step(&mut Undisturbed, &mut |c| {
                seen = Some(Seen {
                    phase: c.output.phase,
                    fault: c.output.fault,
                    shown_n: c.output.force_n,
                    true_n: c.truth.wrench.force.dot(&c.truth.normal),
                });
            });
            seen.unwrap()
        };
        let (phases, peak_n, off_n) = run_until(step, period_s, Phase::Slide, 3.0);
        assert_eq!(phases.contains(&Phase::Clear), start > 0, "{phases:?}");
        assert!(peak_n <= (2.0 * reference_n).max(10.0), "{peak_n} N");
        worst = worst.max(off_n.abs());
        let known = cell.controller().clearance();
        assert!(matches!(known, Clearance::Possible { .. }), "{known:?}");
        cell.controller().begin(known);
    }
    eprintln!("shown off by {worst:.3} N");
    assert!(worst <= SHOWN_MAX_N, "{worst} N");
}
