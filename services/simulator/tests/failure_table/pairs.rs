//! Two faults at once, and what comes after one: how hard the tool truly presses, and that nothing goes on by itself.

use tangent_control::Phase;
use tangent_simulator::Flavour;

use crate::cell::{Cell, Fault};

/// Twice the reference, or this: what the tool may press with whatever happens, N.
const PEAK_N: f64 = 10.0;
/// How long the faults last, cycles.
const LASTS: u64 = 150;
/// Time in which the arm is at rest after them, cycles.
const REST: u64 = 1500;

/// A reading that is zero and says it is valid is no fault that the law can answer by itself: it seeks a surface that it is on.
fn faults() -> impl Iterator<Item = Fault> + Clone {
    Fault::ALL.into_iter().filter(|f| *f != Fault::ContactLost)
}

/// Faults `first` and, so many cycles later, `second` as well; then neither.
fn play(first: Fault, second: Fault, apart: u64, offset: u64) -> Cell {
    let mut cell = Cell::sliding(Flavour::Cb3);
    cell.steps(offset);
    cell.faults = vec![first];
    cell.steps(apart);
    cell.faults.push(second);
    cell.steps(LASTS);
    let dead = cell.has(Fault::BridgeDead);
    cell.faults.clear();
    if dead {
        cell.start_bridge();
    }
    cell
}

#[test]
fn no_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    let mut worst = (0.0, String::new());
    for first in faults() {
        for second in faults() {
            for (apart, offset) in [(0, 0), (1, 7), (3, 13), (14, 21), (60, 5)] {
                let mut cell = play(first, second, apart, offset);
                let what = format!("{first:?}, {apart} cycles later {second:?}");
                let only_another = first == Fault::SecondSource && second == first;
                if only_another {
                    assert_eq!(cell.phase(), Phase::Slide, "{what}");
                    continue;
                }
                cell.steps(REST);
                assert!(
                    !cell.phase().is_active(),
                    "{what}: still in {:?}",
                    cell.phase()
                );
                let place = cell.truth().base_from_tool.translation();
                cell.steps(100);
                let moved = (cell.truth().base_from_tool.translation() - place).norm();
                assert!(moved < 1e-5, "{what}: moved by {moved} m");
                if cell.peak_n > worst.0 {
                    worst = (cell.peak_n, what);
                }
            }
        }
    }
    println!("worst: {:.2} N with {}", worst.0, worst.1);
    assert!(worst.0 <= PEAK_N, "{} N with {}", worst.0, worst.1);
}

#[test]
fn after_every_fault_a_new_start_shows_the_true_force() {
    for fault in faults().filter(|f| *f != Fault::SecondSource) {
        for offset in [0, 9] {
            let mut cell = play(fault, fault, 0, offset);
            cell.steps(REST);
            cell.until("the bridge is ready", |c| c.bridge().is_ready());
            cell.start_task();
            cell.until("it slides again", |c| c.phase() == Phase::Slide);
            let mut worst_n = 0.0_f64;
            for _ in 0..250 {
                cell.step();
                let truth = cell.truth();
                let true_n = truth.wrench.force.dot(&truth.normal);
                worst_n = worst_n.max((cell.output.unwrap().force_n.unwrap() - true_n).abs());
            }
            assert!(
                worst_n <= 0.5,
                "{fault:?}: shown {worst_n} N beside the truth"
            );
            assert!(cell.peak_n <= PEAK_N, "{fault:?}: {} N", cell.peak_n);
        }
    }
}
