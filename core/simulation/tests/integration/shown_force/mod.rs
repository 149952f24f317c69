//! The displayed force equals the true force whatever operators and faults do to a cell: random
//! sequences of starts, pauses, stops, crashes and tares, for every law.

// The test prints its results.
#![allow(clippy::disallowed_macros)]
#![allow(clippy::unwrap_used)]
// Not every test binary uses all of this module.
#![allow(dead_code)]

use std::cell::Cell as Counter;
use std::collections::VecDeque;

use nalgebra::Vector3;
use proptest::prelude::*;
use proptest::test_runner::{TestRunner, contextualize_config};
use tangent_control::{Fault, Phase};

/// Largest difference between the displayed force and the true one, N.
pub const SHOWN_MAX_N: f64 = 0.5;
/// Window over which the means of displayed and true force are compared, s, so that noise does not
/// count. A window ends with every period, and the true force is delayed by the filter's delay.
/// After an interruption of the comparison a new window begins; no further time is left out for
/// settling.
pub const WINDOW_S: f64 = 0.2;
/// Duration of a task after the sequence, s.
const AFTER_S: f64 = 10.0;
/// Duration of a protective stop, s.
const STOPPED_S: f64 = 0.3;

/// Result of one period.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    pub phase: Phase,
    pub fault: Option<Fault>,
    /// True force on the tool, N.
    pub force_n: f64,
    /// Part of the true force that is compared, N, in any axes.
    pub truth: Vector3<f64>,
    /// Displayed force, N, in the same axes; `None` while no force is displayed, or while it is
    /// marked as unusable.
    pub shown: Option<Vector3<f64>>,
}

/// Action of an operator, or a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    Start,
    Pause,
    Resume,
    Stop,
    /// The robot accepts no commands for a moment, while the tool stays on the surface.
    ProtectiveStop,
    /// The controller crashes; a new one takes its place and runs no task.
    ControllerDies,
    /// The sensor service crashes, and a new one takes its place.
    SensorRestarts,
    Tare,
}

/// A cell that supports all actions. It may reject an action.
pub trait Cell {
    fn period_s(&self) -> f64;
    /// Delay of the displayed force relative to the true one, s: the filter's delay.
    fn delay_s(&self) -> f64;
    /// Whether the displayed force is compared in this phase.
    fn compares(&self, phase: Phase) -> bool;
    fn reference_n(&self) -> f64;
    fn phase(&mut self) -> Phase;
    /// Runs one period.
    fn step(&mut self) -> Seen;
    fn set_arm_ready(&mut self, ready: bool);
    /// Carries out any action except [`Action::ProtectiveStop`].
    fn act(&mut self, action: Action);
}

/// A cell with the observations made of it.
pub struct Watched<C> {
    pub cell: C,
    pub peak_n: f64,
    pub worst_n: f64,
    /// Time (s) and phase at the end of the worst window.
    worst_at: (f64, Phase),
    time_s: f64,
    pub phases: Vec<Phase>,
    pub faults: Vec<Fault>,
    /// True forces during the filter's delay, oldest first.
    late: VecDeque<Vector3<f64>>,
    /// Displayed minus true force, over one window.
    differences: VecDeque<Vector3<f64>>,
}

impl<C: Cell> Watched<C> {
    pub fn new(cell: C) -> Self {
        Self {
            cell,
            peak_n: 0.0,
            worst_n: 0.0,
            worst_at: (0.0, Phase::Idle),
            time_s: 0.0,
            phases: Vec::new(),
            faults: Vec::new(),
            late: VecDeque::new(),
            differences: VecDeque::new(),
        }
    }

    /// Discards all observations so far.
    pub fn forget(&mut self) {
        self.differences.clear();
        self.worst_n = 0.0;
    }

    pub fn step(&mut self) {
        let seen = self.cell.step();
        self.time_s += self.cell.period_s();
        self.peak_n = self.peak_n.max(seen.force_n);
        if self.phases.last() != Some(&seen.phase) {
            self.phases.push(seen.phase);
        }
        if let Some(fault) = seen.fault
            && self.faults.last() != Some(&fault)
        {
            self.faults.push(fault);
        }
        self.late.push_back(seen.truth);
        let delay = (self.cell.delay_s() / self.cell.period_s()).round() as usize;
        while self.late.len() > delay + 1 {
            self.late.pop_front();
        }
        let Some(shown) = seen.shown.filter(|_| self.cell.compares(seen.phase)) else {
            self.differences.clear();
            return;
        };
        self.differences.push_back(shown - self.late[0]);
        let window = (WINDOW_S / self.cell.period_s()).round() as usize;
        if self.differences.len() >= window {
            let mean = self.differences.iter().sum::<Vector3<f64>>() / window as f64;
            if mean.norm() > self.worst_n {
                self.worst_n = mean.norm();
                self.worst_at = (self.time_s, seen.phase);
            }
            self.differences.pop_front();
        }
    }

    pub fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / self.cell.period_s()) as usize {
            self.step();
        }
    }

    pub fn run_until(&mut self, wanted: Phase) {
        for _ in 0..(40.0 / self.cell.period_s()) as usize {
            self.step();
            if self.cell.phase() == wanted {
                return;
            }
        }
        panic!("never in {wanted:?}: {:?} {:?}", self.phases, self.faults);
    }

    pub fn act(&mut self, action: Action) {
        if action == Action::ProtectiveStop {
            self.cell.set_arm_ready(false);
            self.run(STOPPED_S);
            self.cell.set_arm_ready(true);
        } else {
            self.cell.act(action);
        }
    }

    /// The violation, if the tool pressed too hard or the displayed force was not the true one.
    pub fn judge(&self) -> Result<(), String> {
        let peak_max_n = (2.0 * self.cell.reference_n()).max(10.0);
        let told = || format!("{:?} {:?}", self.phases, self.faults);
        if self.peak_n > peak_max_n {
            return Err(format!("pressed with {} N: {}", self.peak_n, told()));
        }
        if self.worst_n > SHOWN_MAX_N {
            let (time_s, phase) = self.worst_at;
            return Err(format!(
                "shown {} N off at {time_s:.2} s in {phase:?}: {}",
                self.worst_n,
                told()
            ));
        }
        Ok(())
    }

    pub fn is_true(&self) {
        self.judge().unwrap();
    }
}

/// Actions on a cell, each after a time in s.
#[derive(Clone, Debug)]
pub struct Sequence {
    pub seed: u64,
    pub stiffness_n_per_m: f64,
    pub steps: Vec<(f64, Action)>,
}

fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        2 => Just(Action::Start),
        1 => Just(Action::Pause),
        1 => Just(Action::Resume),
        1 => Just(Action::Stop),
        1 => Just(Action::ProtectiveStop),
        1 => Just(Action::ControllerDies),
        1 => Just(Action::SensorRestarts),
        1 => Just(Action::Tare),
    ]
}

fn sequence(stiffnesses: &'static [f64], longest_s: f64) -> impl Strategy<Value = Sequence> {
    let steps = prop::collection::vec((0.05..longest_s, action()), 0..=12);
    let stiffness = prop::sample::select(stiffnesses);
    (0u64..1_000_000, stiffness, steps).prop_map(|(seed, stiffness_n_per_m, steps)| Sequence {
        seed,
        stiffness_n_per_m,
        steps,
    })
}

/// Runs a sequence of actions, followed by one more start.
pub fn play<C: Cell>(sequence: &Sequence, cell: C) -> Watched<C> {
    let mut cell = Watched::new(cell);
    for (wait_s, action) in &sequence.steps {
        cell.run(*wait_s);
        cell.act(*action);
    }
    cell.act(Action::Resume);
    if !cell.cell.phase().is_active() {
        cell.act(Action::Start);
    }
    cell.run(AFTER_S);
    cell
}

/// Whether the tool stands or slides. While it moves through the air, the wrench also contains
/// inertia of the payload and friction of the joints.
pub fn stands_or_slides(phase: Phase) -> bool {
    !matches!(
        phase,
        Phase::Approach | Phase::Seek | Phase::Clear | Phase::Retract
    )
}

/// Runs this number of sequences, or PROPTEST_CASES, from PROPTEST_RNG_SEED: see .ci/search. At
/// least four of five have to slide.
pub fn whatever_is_done<C: Cell>(
    cases: u32,
    stiffnesses: &'static [f64],
    longest_s: f64,
    make: impl Fn(&Sequence) -> C,
) {
    let (played, slid) = (Counter::new(0_u32), Counter::new(0_u32));
    let worst = Counter::new((0.0_f64, 0.0_f64));
    let mut runner = TestRunner::new(contextualize_config(ProptestConfig {
        cases,
        failure_persistence: None,
        max_shrink_iters: 300,
        ..ProptestConfig::default()
    }));
    runner
        .run(&sequence(stiffnesses, longest_s), |sequence| {
            let cell = play(&sequence, make(&sequence));
            played.set(played.get() + 1);
            slid.set(slid.get() + u32::from(cell.phases.contains(&Phase::Slide)));
            let (peak_n, off_n) = worst.get();
            worst.set((peak_n.max(cell.peak_n), off_n.max(cell.worst_n)));
            cell.judge().map_err(TestCaseError::fail)
        })
        .unwrap();
    let (peak_n, off_n) = worst.get();
    let (played, slid) = (played.get(), slid.get());
    eprintln!("{played} sequences, {slid} slid; at most {peak_n:.2} N, shown off by {off_n:.3} N");
    assert!(5 * slid > 4 * played, "{slid} of {played} sequences slid");
}
