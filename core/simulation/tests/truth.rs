//! The force shown is the true force: random sequences of starts, pauses, protective stops, deaths of the controller and of the
//! sensor's service, and tares; by the simulator's truth.

// A test says what it found, and reads the scenarios that ship.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

use std::collections::VecDeque;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tangent_control::{Clearance, Fault, Phase, Task};
use tangent_simulation::{ClosedLoop, Scenario};

/// Largest difference between the force shown and the true one, N.
const SHOWN_MAX_N: f64 = 0.5;
/// Shown and true are compared as means over so many cycles: the filter's delay is no lie.
const MEAN_CYCLES: usize = 25;

/// A cell in which everything that a person or a fault does can be done.
struct Cell {
    cell: ClosedLoop,
    task: Task,
    peak_n: f64,
    worst_n: f64,
    differences: VecDeque<Vector3<f64>>,
    phases: Vec<Phase>,
    faults: Vec<Fault>,
}

impl Cell {
    fn new(stiffness_n_per_m: f64, seed: u64) -> Self {
        let text = include_str!("../../../scenarios/plane.toml");
        let overrides = [
            format!("seed={seed}"),
            format!("plant.contact.stiffness_n_per_m={stiffness_n_per_m:.1}"),
            "plant.sensor.bias_n=5.0".to_owned(),
            "plant.sensor.bias_nm=0.2".to_owned(),
            "plant.sensor.noise_n_per_sqrt_hz=0.002".to_owned(),
            "plant.start.clearance_m=0.004".to_owned(),
            "task.end.retract_distance_m=0.01".to_owned(),
        ];
        let scenario = Scenario::parse("truth", text, &overrides, &|_| Err(String::new())).unwrap();
        Self {
            cell: ClosedLoop::new(&scenario).unwrap(),
            task: scenario.task,
            peak_n: 0.0,
            worst_n: 0.0,
            differences: VecDeque::new(),
            phases: Vec::new(),
            faults: Vec::new(),
        }
    }

    fn phase(&mut self) -> Phase {
        self.cell.controller().phase()
    }

    fn step(&mut self) {
        let (mut force, mut tool) = (Vector3::zeros(), None);
        let (mut phase, mut fault) = (Phase::Idle, None);
        let _ = self.cell.step(&mut |cycle| {
            force = cycle.truth.wrench.force;
            tool = Some(cycle.input.base_from_tool);
            (phase, fault) = (cycle.output.phase, cycle.output.fault);
        });
        self.peak_n = self.peak_n.max(force.norm());
        if self.phases.last() != Some(&phase) {
            self.phases.push(phase);
        }
        if let Some(fault) = fault
            && self.faults.last() != Some(&fault)
        {
            self.faults.push(fault);
        }
        let shown = self.cell.shown().unwrap();
        if shown.bias_age_s.is_none() {
            // Nothing is shown without a zero.
            self.differences.clear();
            return;
        }
        let shown = tool.unwrap().rotate(&shown.wrench.force);
        self.differences.push_back(shown - force);
        if self.differences.len() > MEAN_CYCLES {
            self.differences.pop_front();
            let mean = self.differences.iter().sum::<Vector3<f64>>() / MEAN_CYCLES as f64;
            self.worst_n = self.worst_n.max(mean.norm());
        }
    }

    fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / 0.008) as usize {
            self.step();
        }
    }

    fn run_until(&mut self, wanted: Phase) {
        for _ in 0..5000 {
            self.step();
            if self.phase() == wanted {
                return;
            }
        }
        panic!("never in {wanted:?}: {:?} {:?}", self.phases, self.faults);
    }

    /// A fault that leaves the tool on the surface: the robot takes no commands for a moment.
    fn protective_stop(&mut self) {
        self.cell.set_arm_ready(false);
        self.run(0.3);
        self.cell.set_arm_ready(true);
    }

    fn start(&mut self) {
        let task = self.task.clone();
        self.cell.start(&task).unwrap();
    }

    fn is_true(&self) {
        let peak_max_n = (2.0 * self.task.force.reference_n).max(10.0);
        let told = || format!("{:?} {:?}", self.phases, self.faults);
        assert!(self.peak_n <= peak_max_n, "{} N: {}", self.peak_n, told());
        assert!(
            self.worst_n <= SHOWN_MAX_N,
            "shown {} N off: {}",
            self.worst_n,
            told()
        );
    }
}

/// The first start tares pressed, and the one after it on top of that: 3, 6, 9 N.
#[test]
fn a_start_after_a_stop_on_the_surface_moves_off_first() {
    for death in [Cell::protective_stop, |cell: &mut Cell| {
        cell.cell.restart_controller().unwrap();
        cell.run(0.3);
    }] {
        let mut cell = Cell::new(5000.0, 1);
        for _ in 0..4 {
            cell.run_until(Phase::Slide);
            cell.run(1.0);
            death(&mut cell);
            cell.run(0.3);
            assert!(!cell.phase().is_active());
            cell.start();
            cell.step();
            assert_eq!(cell.phase(), Phase::Clear);
        }
        cell.run_until(Phase::Slide);
        cell.run(1.0);
        cell.cell.controller().stop();
        cell.run_until(Phase::Done);
        assert_eq!(cell.cell.controller().clearance(), Clearance::Free);
        cell.is_true();
    }
}

#[test]
fn a_tare_is_refused_while_pressing_sliding_or_paused_and_after() {
    let mut cell = Cell::new(5000.0, 2);
    cell.run_until(Phase::Slide);
    for said_clear in [false, true] {
        assert!(cell.cell.ask_for_tare(said_clear).is_err());
    }
    cell.cell.controller().pause().unwrap();
    cell.run_until(Phase::Hold);
    assert!(cell.cell.ask_for_tare(true).is_err());
    cell.run(1.0);
    cell.protective_stop();
    // It stands pressed: a person may say that it hangs free, and nobody else.
    assert!(cell.cell.ask_for_tare(false).is_err());
    cell.run(1.0);
    cell.is_true();
}

/// Without any memory, the zero itself says so: it jumps against the last good one, or is touched at once.
#[test]
fn a_zero_taken_in_contact_is_found_out_without_any_memory() {
    let mut cell = Cell::new(5000.0, 3);
    cell.run_until(Phase::Slide);
    cell.run(1.0);
    cell.protective_stop();
    // The state folder was lost: it counts as free. The zero jumps against the last one, so there is none.
    let forget = |cell: &mut Cell| {
        cell.cell
            .controller()
            .set_clearance(Clearance::Free)
            .unwrap();
    };
    forget(&mut cell);
    cell.start();
    cell.run_until(Phase::Fault);
    assert_eq!(cell.faults.last(), Some(&Fault::NoTare));
    cell.is_true();
    // The last good zero is lost too: the approach touches at once, and the zero is taken back.
    cell.cell.forget_zeros();
    forget(&mut cell);
    cell.start();
    cell.run_until(Phase::Fault);
    assert_eq!(cell.faults.last(), Some(&Fault::ZeroInContact));
    assert!(cell.cell.shown().unwrap().bias_age_s.is_none());
    assert!(cell.peak_n < 10.0, "{}", cell.peak_n);
    // That retraction ended in free space: the next start is a good one.
    cell.differences.clear();
    cell.worst_n = 0.0;
    cell.start();
    cell.run_until(Phase::Slide);
    cell.run(1.0);
    cell.is_true();
}

#[test]
fn whatever_the_sequence_of_stops_restarts_and_tares() {
    let mut slid = 0;
    let mut worst = (0.0_f64, 0.0_f64);
    for seed in 0..60 {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let stiffness = [2e3, 5e3, 1e4, 2.5e4][rng.random_range(0..4)];
        let mut cell = Cell::new(stiffness, seed);
        for _ in 0..12 {
            cell.run(rng.random_range(0.05..3.0));
            match rng.random_range(0..8) {
                0 | 1 => {
                    let task = cell.task.clone();
                    // Refused while one runs.
                    let _ = cell.cell.start(&task);
                }
                2 => {
                    let _ = cell.cell.controller().pause();
                }
                3 => {
                    let _ = cell.cell.controller().resume();
                }
                4 => cell.protective_stop(),
                5 => cell.cell.restart_controller().unwrap(),
                6 => cell.cell.restart_sensor(),
                _ => {
                    let _ = cell.cell.ask_for_tare(false);
                }
            }
        }
        if !cell.phase().is_active() {
            cell.start();
        }
        cell.run(8.0);
        slid += usize::from(cell.phases.contains(&Phase::Slide));
        worst = (worst.0.max(cell.peak_n), worst.1.max(cell.worst_n));
        eprintln!(
            "seed {seed}: peak {:.2} N, shown off by {:.3} N, {:?}",
            cell.peak_n, cell.worst_n, cell.faults
        );
        cell.is_true();
    }
    eprintln!(
        "worst: peak {:.2} N, shown off by {:.3} N",
        worst.0, worst.1
    );
    assert!(slid > 50, "{slid} of 60 sequences slid");
}
