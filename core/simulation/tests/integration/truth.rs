//! The displayed force equals the true force from the simulator, under the law of the
//! velocity-controlled arms.

// A whole file of tests: what fails here is the test.
use crate::shown_force::{Action, Cell, Seen, Watched, whatever_is_done};
use tangent_control::{Clearance, Fault, Phase, Task};
use tangent_simulation::{AdmittanceLoop, AdmittanceScenario, no_files};

/// A cell that supports all actions of operators and all faults.
struct VelocityCell {
    cell: AdmittanceLoop,
    task: Task,
}

fn velocity_cell(stiffness_n_per_m: f64, seed: u64) -> VelocityCell {
    let text = include_str!("../../../../scenarios/plane.toml");
    let overrides = [
        format!("seed={seed}"),
        format!("plant.contact.stiffness_n_per_m={stiffness_n_per_m:.1}"),
        "plant.sensor.bias_n=5.0".to_owned(),
        "plant.sensor.bias_nm=0.2".to_owned(),
        "plant.sensor.noise_n_per_sqrt_hz=0.002".to_owned(),
        "plant.start.clearance_m=0.004".to_owned(),
        "task.end.retract_distance_m=0.01".to_owned(),
    ];
    let scenario = AdmittanceScenario::parse("truth", text, &overrides, &no_files).unwrap();
    VelocityCell {
        cell: AdmittanceLoop::new(&scenario).unwrap(),
        task: scenario.task,
    }
}

fn watched(stiffness_n_per_m: f64, seed: u64) -> Watched<VelocityCell> {
    Watched::new(velocity_cell(stiffness_n_per_m, seed))
}

impl Cell for VelocityCell {
    fn period_s(&self) -> f64 {
        self.cell.plant().period_s()
    }

    fn delay_s(&self) -> f64 {
        self.cell.shown().map_or(0.0, |shown| shown.delay_s)
    }

    fn compares(&self, _: Phase) -> bool {
        true
    }

    fn reference_n(&self) -> f64 {
        self.task.force.reference_n
    }

    fn phase(&mut self) -> Phase {
        self.cell.controller().phase()
    }

    fn step(&mut self) -> Seen {
        let mut seen = None;
        let _ = self.cell.step(&mut |cycle| {
            let shown = cycle.input.base_from_tool.rotate(&cycle.input.wrench.force);
            seen = Some(Seen {
                phase: cycle.output.phase,
                fault: cycle.output.fault,
                force_n: cycle.truth.wrench.force.norm(),
                truth: cycle.truth.wrench.force,
                shown: cycle.input.bias_age_s.map(|_| shown),
            });
        });
        seen.unwrap()
    }

    fn set_arm_ready(&mut self, ready: bool) {
        self.cell.set_arm_ready(ready);
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Start => {
                // Rejected while a task runs.
                let _ = self.cell.start(&self.task);
            }
            Action::Pause => {
                let _ = self.cell.controller().pause();
            }
            Action::Resume => {
                let _ = self.cell.controller().resume();
            }
            Action::Stop => self.cell.controller().stop(),
            Action::ControllerDies => self.cell.restart_controller().unwrap(),
            Action::SensorRestarts => self.cell.restart_sensor(),
            Action::Tare => {
                let _ = self.cell.ask_for_tare(false);
            }
            Action::ProtectiveStop => {}
        }
    }
}

/// Once, the first start tared in contact, and so did each one after it: 3, 6, 9 N.
#[test]
fn a_start_after_a_stop_on_the_surface_moves_off_first() {
    for death in [Action::ProtectiveStop, Action::ControllerDies] {
        let mut cell = watched(5000.0, 1);
        for _ in 0..4 {
            cell.run_until(Phase::Slide);
            cell.run(1.0);
            cell.act(death);
            cell.run(0.3);
            assert!(!cell.cell.phase().is_active());
            cell.act(Action::Start);
            cell.step();
            assert_eq!(cell.cell.phase(), Phase::Clear);
        }
        cell.run_until(Phase::Slide);
        cell.run(1.0);
        cell.cell.cell.controller().stop();
        cell.run_until(Phase::Done);
        assert_eq!(cell.cell.cell.controller().clearance(), Clearance::Free);
        cell.is_true();
    }
}

/// A controller that knows only the stored state of its predecessor retracts, and does nothing
/// more.
#[test]
fn a_stop_after_a_restart_leaves_the_surface() {
    for stiffness_n_per_m in [1000.0, 5000.0, 30_000.0] {
        let mut cell = watched(stiffness_n_per_m, 4);
        cell.run_until(Phase::Slide);
        cell.run(1.0);
        cell.act(Action::ControllerDies);
        cell.run(0.3);
        assert!(!cell.cell.cell.controller().clearance().is_free());
        cell.cell.cell.start(&Task::leave(30.0)).unwrap();
        cell.phases.clear();
        cell.run_until(Phase::Done);
        assert_eq!(cell.phases, [Phase::Clear, Phase::Done]);
        assert_eq!(cell.cell.cell.controller().clearance(), Clearance::Free);
        cell.run(0.3);
        assert_eq!(cell.cell.step().force_n, 0.0);
        cell.is_true();
    }
}

#[test]
fn a_tare_is_refused_while_pressing_sliding_or_paused_and_after() {
    let mut cell = watched(5000.0, 2);
    cell.run_until(Phase::Slide);
    for said_clear in [false, true] {
        assert!(cell.cell.cell.ask_for_tare(said_clear).is_err());
    }
    cell.cell.cell.controller().pause().unwrap();
    cell.run_until(Phase::Hold);
    assert!(cell.cell.cell.ask_for_tare(true).is_err());
    cell.run(1.0);
    cell.act(Action::ProtectiveStop);
    // The tool is pressed: an operator may state that it hangs free, but a plain request is
    // rejected.
    assert!(cell.cell.cell.ask_for_tare(false).is_err());
    cell.run(1.0);
    cell.is_true();
}

/// Without any stored state, a zero taken in contact is detected from the zero itself: it jumps
/// against the last good one, or the approach touches at once.
#[test]
fn a_zero_taken_in_contact_is_found_out_without_any_memory() {
    let mut cell = watched(5000.0, 3);
    cell.run_until(Phase::Slide);
    cell.run(1.0);
    cell.act(Action::ProtectiveStop);
    // The state folder was lost, so the tool counts as free. The zero jumps against the last one,
    // so it is rejected.
    let forget = |cell: &mut Watched<VelocityCell>| {
        cell.cell
            .cell
            .controller()
            .set_clearance(Clearance::Assumed)
            .unwrap();
    };
    forget(&mut cell);
    cell.act(Action::Start);
    cell.run_until(Phase::Fault);
    assert_eq!(cell.faults.last(), Some(&Fault::NoTare));
    cell.is_true();
    // The last good zero is lost too: the approach touches at once, and the zero is withdrawn.
    cell.cell.cell.forget_zeros();
    forget(&mut cell);
    cell.act(Action::Start);
    cell.run_until(Phase::Fault);
    assert_eq!(cell.faults.last(), Some(&Fault::ZeroInContact));
    assert!(cell.cell.cell.shown().unwrap().bias_age_s.is_none());
    assert!(cell.peak_n < 10.0, "{}", cell.peak_n);
    // That retraction ended in free space, so the next start is a good one.
    cell.forget();
    cell.act(Action::Start);
    cell.run_until(Phase::Slide);
    cell.run(1.0);
    cell.is_true();
}

#[test]
fn whatever_the_sequence_of_stops_restarts_and_tares() {
    whatever_is_done(60, &[2e3, 5e3, 1e4, 2.5e4], 3.0, |sequence| {
        velocity_cell(sequence.stiffness_n_per_m, sequence.seed)
    });
}
