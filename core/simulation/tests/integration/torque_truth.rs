//! The displayed force equals the true force under the torque laws: a task that starts while the
//! tool presses retracts first.

// The test prints its results, and reads the scenarios of the repository.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
// A whole file of tests: what fails here is the test.
use crate::shown_force::{
    Action, Cell, Seen as Shown, Sequence, play, stands_or_slides, whatever_is_done,
};
use crate::tactile_cells;
use nalgebra::Vector3;
use tangent_control::{Clearance, Fault, Law, Phase, TorqueLaw};
use tangent_simulation::{ObjectLoop, ObjectScenario, Undisturbed, VisuoTactileLoop};

/// Largest difference between the means of displayed and true force while the tool slides, N.
const SHOWN_MAX_N: f64 = 0.5;

/// Result of one period: phase, fault, displayed force and true force along the normal, N.
#[derive(Clone, Copy, Debug)]
struct Seen {
    phase: Phase,
    fault: Option<Fault>,
    shown_n: Option<f64>,
    true_n: f64,
}

/// Steps until `wanted`, then for `more_s`. Returns the phases on the way, the largest true force,
/// and the mean difference while the tool slid.
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
    let mut cell = VisuoTactileLoop::<7>::new(&scenario).unwrap();
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
        // The controller crashes while the tool presses; the next one knows the direction away from
        // the surface.
        let known = cell.controller().clearance();
        assert!(matches!(known, Clearance::Possible { .. }), "{known:?}");
        cell.controller().begin(known);
    }
    eprintln!("shown off by {worst:.3} N");
    assert!(worst <= SHOWN_MAX_N, "{worst} N");
}

#[test]
fn hybrid_dynamics_moves_off_before_the_tare() {
    let text = include_str!("../../../../scenarios/lippiello/lippiello_realistic.toml");
    let scenario = ObjectScenario::parse("truth", text, &[]).unwrap();
    let reference_n = scenario.task.force.reference_n;
    let mut cell = ObjectLoop::<6>::new(&scenario).unwrap();
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

/// Behaviour that the robot and the controller service add to a torque law. A stop ends the task
/// for the robot: it holds itself until a task is started again, as it does while no task runs.
#[derive(Clone, Copy, Debug, Default)]
struct Service {
    stopped: bool,
    /// State of the tool that is passed to the next controller after a crash. That controller runs
    /// no task.
    died: Option<Clearance>,
}

/// A cell of a torque law, with the requests specific to that law.
macro_rules! torque_cell {
    ($name:ident, $cell:ty) => {
        struct $name {
            cell: $cell,
            service: Service,
            reference_n: f64,
            delay_s: f64,
        }

        impl $name {
            fn active_phase(&mut self) -> Phase {
                if self.service.died.is_some() {
                    return Phase::Idle;
                }
                self.cell.controller().phase()
            }

            fn start(&mut self) {
                if self.active_phase().is_active() {
                    return;
                }
                let known = self
                    .service
                    .died
                    .unwrap_or(self.cell.controller().clearance());
                let at = self.cell.plant().truth().base_from_tool.translation();
                let law = self.cell.controller();
                if law.check_start(&known, &at).is_ok() {
                    law.begin(known);
                    self.service = Service::default();
                    self.cell.set_arm_ready(true);
                }
            }

            /// Updates the robot's state after a period.
            fn after(&mut self) {
                if !self.service.stopped && !self.active_phase().is_active() {
                    self.stop_arm();
                }
            }

            fn stop_arm(&mut self) {
                if !self.service.stopped {
                    self.service.stopped = true;
                    self.cell.set_arm_ready(false);
                }
            }

            fn ask(&mut self, action: Action) {
                let alive = self.service.died.is_none();
                let law = self.cell.controller();
                match action {
                    Action::Start => self.start(),
                    Action::Pause if alive => drop(law.pause(true)),
                    Action::Resume if alive => drop(law.pause(false)),
                    Action::Stop if alive => law.stop(),
                    Action::ControllerDies if alive => {
                        let known = law.clearance();
                        // It requests no zero any more.
                        law.stop();
                        self.service.died = Some(known);
                        self.stop_arm();
                    }
                    _ => {}
                }
            }
        }
    };
}

torque_cell!(UnifiedCell, VisuoTactileLoop);
torque_cell!(HybridCell, ObjectLoop);

/// Methods that both cells implement alike.
macro_rules! alike {
    () => {
        fn period_s(&self) -> f64 {
            self.cell.plant().period_s()
        }

        fn delay_s(&self) -> f64 {
            self.delay_s
        }

        fn compares(&self, phase: Phase) -> bool {
            stands_or_slides(phase)
        }

        fn reference_n(&self) -> f64 {
            self.reference_n
        }

        fn phase(&mut self) -> Phase {
            self.active_phase()
        }

        fn set_arm_ready(&mut self, ready: bool) {
            if !ready {
                self.stop_arm();
            }
        }
    };
}

impl Cell for UnifiedCell {
    alike!();

    fn step(&mut self) -> Shown {
        let (alive, mut seen) = (self.service.died.is_none(), None);
        self.cell.step(&mut Undisturbed, &mut |c| {
            let zeroed = alive && c.output.zero_age_s.is_some();
            seen = Some(Shown {
                phase: c.output.phase,
                fault: c.output.fault,
                force_n: c.truth.wrench.force.norm(),
                truth: Vector3::z() * c.truth.wrench.force.dot(&c.truth.normal),
                shown: c
                    .output
                    .force_n
                    .filter(|_| zeroed)
                    .map(|n| Vector3::z() * n),
            });
        });
        self.after();
        seen.unwrap()
    }

    fn act(&mut self, action: Action) {
        // The robot itself is the sensor, and the law manages its zero.
        self.ask(action);
    }
}

impl Cell for HybridCell {
    alike!();

    fn step(&mut self) -> Shown {
        let mut seen = None;
        self.cell.step(&mut Undisturbed, &mut |c| {
            let shown = c.output.base_from_tool.rotate(&c.input.wrench.force);
            seen = Some(Shown {
                phase: c.output.phase,
                fault: c.output.fault,
                force_n: c.truth.wrench.force.norm(),
                truth: c.truth.wrench.force,
                shown: c.input.bias_age_s.map(|_| shown),
            });
        });
        self.after();
        if let Some(shown) = self.cell.shown() {
            self.delay_s = shown.delay_s;
        }
        seen.unwrap()
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::SensorRestarts => self.cell.restart_sensor(),
            Action::Tare => drop(self.cell.ask_for_tare(false)),
            other => self.ask(other),
        }
    }
}

/// `zero_nm`: standard deviation of the zeros of the robot's own torque sensors.
fn unified_cell(sequence: &Sequence, zero_nm: f64) -> UnifiedCell {
    let scenario = tactile_cells::scenario(&[
        &format!("plant.external_wrench.torque_bias_nm={zero_nm}"),
        &format!("seed={}", sequence.seed),
        &format!(
            "plant.contact.stiffness_n_per_m={:.1}",
            sequence.stiffness_n_per_m
        ),
        "plant.start.clearance_m=0.015",
        "task.end.retract_distance_m=0.02",
    ]);
    UnifiedCell {
        cell: VisuoTactileLoop::<7>::new(&scenario).unwrap(),
        service: Service::default(),
        reference_n: scenario.task.force.reference_n,
        delay_s: scenario.law().unwrap().touch.wrench_lag_s,
    }
}

fn hybrid_cell(sequence: &Sequence) -> HybridCell {
    let text = include_str!("../../../../scenarios/lippiello/lippiello_realistic.toml");
    let set = [
        format!("seed={}", sequence.seed),
        format!(
            "plant.contact.stiffness_n_per_m={:.1}",
            sequence.stiffness_n_per_m
        ),
        "plant.start.clearance_m=0.03".to_owned(),
        "task.end.retract_distance_m=0.02".to_owned(),
        // A sensor that mixes its axes shows another force than the true one, whatever its zero.
        "plant.errors_drawn.cross_talk=0.0".to_owned(),
        "plant.errors_drawn.sensor_rotation_rad=0.0".to_owned(),
    ];
    let scenario = ObjectScenario::parse("truth", text, &set).unwrap();
    HybridCell {
        cell: ObjectLoop::<6>::new(&scenario).unwrap(),
        service: Service::default(),
        reference_n: scenario.task.force.reference_n,
        delay_s: 0.0,
    }
}

/// The robot's torque sensors have no zero errors here: their effect is independent of the actions
/// on the cell.
#[test]
fn whatever_is_done_to_unified_force_impedance() {
    whatever_is_done(8, &[2e4, 5e4], 4.0, |sequence| unified_cell(sequence, 0.0));
}

/// No action is taken. A constant torque error of a joint causes a different wrench in a posture
/// other than that of the tare.
#[test]
#[ignore = "0.56 N: 0.05 Nm of a joint's own zero, and friction that is told a fifth too low, are in the robot's estimate"]
fn the_zeros_of_the_robots_own_torque_sensors_are_not_shown() {
    let sequence = Sequence {
        seed: 283_100,
        stiffness_n_per_m: 2e4,
        steps: Vec::new(),
    };
    play(&sequence, unified_cell(&sequence, 0.05)).is_true();
}

#[test]
fn whatever_is_done_to_hybrid_dynamics() {
    whatever_is_done(8, &[5e3, 1e4], 4.0, hybrid_cell);
}
