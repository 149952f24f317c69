//! During a pause the tool stands still in every phase of both torque laws, by the plant's true
//! state, and the task continues from there.

// A whole file of tests: what fails here is the test.
use crate::tactile_cells;
use nalgebra::Vector3;
use tangent_control::UnifiedInput;
use tangent_control::{ControlError, Law, Phase};
use tangent_simulation::{Disturbance, ObjectLoop, ObjectScenario, Undisturbed, VisuoTactileLoop};

const OBJECT: &str = include_str!("../../../../scenarios/lippiello/lippiello_realistic.toml");
/// Observation time, s: longer than settling, holding and the tare of any of these tasks.
const WATCH_S: f64 = 4.0;
/// Time in which the path's clock stops and a compliant arm sinks into its springs, s.
const SETTLE_S: f64 = 2.0;
/// Distance that a standing tool may wander, m: sensor noise, stick-slip, refinement of the
/// estimate.
const WANDER_M: f64 = 2e-3;
/// Distance that its mean position may move from the first second of the observation to the last,
/// m. The slowest motion of these tasks covers ten times this distance in three seconds.
const DRIFT_M: f64 = 1e-3;

/// True state in one period.
struct Seen {
    phase: Phase,
    /// Position of the tool, m.
    at: Vector3<f64>,
    /// Progress along the path, 0 to 1.
    progress: f64,
}

/// A closed loop that can be paused.
trait Paused {
    fn period(&mut self) -> Seen;
    fn pause(&mut self, paused: bool) -> Result<(), ControlError>;
    fn period_s(&self) -> f64;
}

impl Paused for VisuoTactileLoop {
    fn period(&mut self) -> Seen {
        let mut progress = None;
        let (cycle, _) = self.step(&mut Undisturbed, &mut |c| {
            progress = Some(c.output.path_progress)
        });
        Seen {
            phase: cycle.phase,
            at: self.plant().truth().base_from_tool.translation(),
            progress: progress.unwrap(),
        }
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.controller().pause(paused)
    }

    fn period_s(&self) -> f64 {
        self.plant().period_s()
    }
}

impl Paused for ObjectLoop {
    fn period(&mut self) -> Seen {
        let mut progress = None;
        let (cycle, _) = self.step(&mut Undisturbed, &mut |c| {
            progress = Some(c.output.path_progress)
        });
        Seen {
            phase: cycle.phase,
            at: self.plant().truth().base_from_tool.translation(),
            progress: progress.unwrap(),
        }
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.controller().pause(paused)
    }

    fn period_s(&self) -> f64 {
        self.plant().period_s()
    }
}

fn run_until(law: &mut impl Paused, phase: Phase) {
    for _ in 0..(60.0 / law.period_s()) as usize {
        if law.period().phase == phase {
            return;
        }
    }
    panic!("never in {phase:?}");
}

/// Runs for this time, s; returns the last period.
fn run_for(law: &mut impl Paused, time_s: f64) -> Seen {
    let periods = (time_s / law.period_s()) as usize;
    (0..periods).map(|_| law.period()).last().unwrap()
}

/// Mean position of the tool, m.
fn mean(places: &[Vector3<f64>]) -> Vector3<f64> {
    places.iter().sum::<Vector3<f64>>() / places.len() as f64
}

/// Pauses `after_s` into `phase` and checks that the tool and the path's clock stand still, that no
/// phase changes, and that the task afterwards continues along its path.
fn stands(law: &mut impl Paused, phase: Phase, after_s: f64) {
    run_until(law, phase);
    run_for(law, after_s);
    law.pause(true).unwrap();
    let settled = run_for(law, SETTLE_S);
    let mut places = Vec::new();
    for _ in 0..(WATCH_S / law.period_s()) as usize {
        let seen = law.period();
        let stays = seen.phase == phase || (phase, seen.phase) == (Phase::Slide, Phase::Hold);
        assert!(stays, "{phase:?}: {:?}", seen.phase);
        assert_eq!(seen.progress, settled.progress, "{phase:?}");
        let wandered = (seen.at - settled.at).norm();
        assert!(wandered < WANDER_M, "{phase:?}: {wandered} m away");
        places.push(seen.at);
    }
    let second = (1.0 / law.period_s()) as usize;
    let (first, last) = (&places[..second], &places[places.len() - second..]);
    let drift = (mean(last) - mean(first)).norm();
    assert!(drift < DRIFT_M, "{phase:?}: moves on, {drift} m");
    law.pause(false).unwrap();
    if phase != Phase::Slide {
        run_until(law, Phase::Slide);
    }
    let before = law.period().at;
    let after = run_for(law, 2.0).at;
    assert!((after - before).norm() > 1e-3, "{phase:?}: does not go on");
}

#[test]
fn unified_force_impedance_stands_in_every_phase() {
    for (phase, after_s) in [
        (Phase::Tare, 0.05),
        (Phase::Approach, 0.3),
        (Phase::Contact, 0.02),
        (Phase::Slide, 0.5),
    ] {
        let scenario = tactile_cells::scenario(&["seed=3"]);
        let mut law = VisuoTactileLoop::<7>::new(&scenario).unwrap();
        stands(&mut law, phase, after_s);
    }
}

#[test]
fn hybrid_dynamics_stands_in_every_phase() {
    for (phase, after_s) in [
        (Phase::Tare, 0.05),
        (Phase::Approach, 0.3),
        (Phase::Contact, 0.02),
        (Phase::Slide, 0.5),
    ] {
        let scenario = ObjectScenario::parse("lippiello_realistic", OBJECT, &[]).unwrap();
        let mut law = ObjectLoop::<6>::new(&scenario).unwrap();
        stands(&mut law, phase, after_s);
    }
}

/// The arm's state contains numbers that are not finite.
struct Blind;

impl Disturbance for Blind {
    fn input(&mut self, input: &mut UnifiedInput) {
        input.q[0] = f64::NAN;
    }
}

#[test]
fn unified_force_impedance_takes_a_tool_off_that_a_fault_left_on_the_surface() {
    let mut law = VisuoTactileLoop::<7>::new(&tactile_cells::scenario(&["seed=3"])).unwrap();
    run_until(&mut law, Phase::Slide);
    law.step(&mut Blind, &mut |_| ());
    for _ in 0..500 {
        assert_eq!(law.period().phase, Phase::Fault);
    }
    let before = law.plant().truth();
    assert!(before.in_contact && law.controller().is_left_on_surface());
    law.controller().leave_surface(0);
    run_until(&mut law, Phase::Fault);
    let after = law.plant().truth();
    assert!(!after.in_contact && after.distance_m > 5e-3, "{after:?}");
    assert!(!law.controller().is_left_on_surface());
}
