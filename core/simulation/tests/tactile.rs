//! Closed loops of `unified_force_impedance`: what must hold whatever the surface, the policy, and what fails.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;
use tangent_control::{Phase, UnifiedInput, VisionInput};
use tangent_mechanics::Joints;
use tangent_sensing::Validity;
use tangent_simulation::{
    Calm, Evaluation, TactileCycle, TactileDisturbance, TactileScenario, evaluate_tactile,
    evaluate_tactile_with,
};

const WAVE: &str = include_str!("../../../scenarios/karacan/karacan_wave.toml");

fn scenario(set: &[&str]) -> TactileScenario {
    let set: Vec<String> = set.iter().map(|s| (*s).to_owned()).collect();
    TactileScenario::parse("karacan_wave", WAVE, &set).unwrap()
}

fn short() -> Vec<&'static str> {
    vec!["task.path.duration_s=6.0", "duration_s=30.0"]
}

fn run(set: &[&str]) -> Evaluation {
    evaluate_tactile(&scenario(set)).unwrap()
}

#[test]
fn both_presets_wipe_the_wave_to_the_end() {
    for (preset, mad, rmse) in [("default", 0.5, 0.75), ("paper", 2.0, 3.0)] {
        let preset_set = format!("controller=\"{preset}\"");
        let e = run(&[&preset_set, "seed=21"]);
        assert_eq!((e.phase, e.fault), ("done", None), "{preset}");
        let force = e.figures.force;
        assert!(force.mad_n.unwrap() <= mad, "{preset}: {force:?}");
        assert!(force.rmse_n.unwrap() <= rmse, "{preset}: {force:?}");
        let path = e.figures.path.mad_xyz_m.unwrap();
        let most = if preset == "default" {
            [0.002, 0.002, 0.001]
        } else {
            [0.009, 0.008, 0.004]
        };
        assert!((0..3).all(|i| path[i] <= most[i]), "{preset}: {path:?}");
        assert_eq!(e.tactile.unwrap().short_j, Some(0.0));
        assert!(e.tactile.unwrap().vision_rate_hz >= 30.0);
    }
}

#[test]
fn equal_input_gives_equal_bits() {
    let set = short();
    assert_eq!(run(&set).state_digest, run(&set).state_digest);
    let mut other = set.clone();
    other.push("seed=2");
    assert_ne!(run(&set).state_digest, run(&other).state_digest);
}

/// Books of a run: what the plant says went through its ports against what the law says.
#[derive(Default)]
struct Audit {
    start_j: Option<f64>,
    worst_books_j: f64,
    worst_tanks_j: f64,
    tank_low: f64,
    gravity_j: f64,
    last: Option<Joints<7>>,
    gravity_under_way: [Joints<7>; 2],
}

impl Audit {
    fn new() -> Self {
        Self {
            tank_low: f64::INFINITY,
            ..Self::default()
        }
    }

    fn see(&mut self, c: &TactileCycle<'_>) {
        let plant = c.plant;
        let arm = plant.arm();
        // Gravity compensation is no part of the law's books: its work by the same rule, a period later as the torque acts.
        if let Some(q) = self.last {
            self.gravity_j += self.gravity_under_way[1].dot(&(arm.q - q));
        } else {
            // Before the law's first torque acts, the motors hold the arm.
            self.gravity_under_way = [plant.torque_applied(); 2];
        }
        self.last = Some(arm.q);
        self.gravity_under_way = [c.output.held_torque, self.gravity_under_way[0]];
        let (energy, books) = (plant.energy(), c.output.tanks);
        let tanks = books.motion_j + books.force_j;
        let tanks_0 = *self.start_j.get_or_insert(tanks);
        // The law's account of its work against the plant's.
        let by_motors = energy.motors_j - self.gravity_j;
        self.worst_books_j = self.worst_books_j.max((by_motors - books.work_j).abs());
        // The tanks hold what was not worked or dissipated.
        let held = tanks_0 - books.work_j - books.dissipated_j + books.short_j;
        self.worst_tanks_j = self.worst_tanks_j.max((tanks - held).abs());
        self.tank_low = self.tank_low.min(books.motion_j).min(books.force_j);
    }
}

/// No noise on the positions, so that plant and law see the same ones, and no error of the payload, so that gravity is cancelled.
const EXACT: [&str; 3] = [
    "plant.arm.encoder_resolution_rad=0.0",
    "plant.tool.payload_error.mass_kg=0.0",
    "plant.tool.payload_error.com_in_sensor_m=[0.0,0.0,0.0]",
];

#[test]
fn the_energy_books_close_against_the_plants_to_a_microjoule() {
    for preset in ["controller=\"default\"", "controller=\"paper\""] {
        let mut set = EXACT.to_vec();
        set.push(preset);
        let mut audit = Audit::new();
        let e = evaluate_tactile_with(&scenario(&set), &mut Calm, |c| audit.see(c)).unwrap();
        assert_eq!(e.phase, "done");
        assert!(
            audit.worst_books_j < 1e-6,
            "{preset}: {}",
            audit.worst_books_j
        );
        assert!(
            audit.worst_tanks_j < 1e-6,
            "{preset}: {}",
            audit.worst_tanks_j
        );
        assert!(audit.tank_low >= 1.0, "{preset}: {}", audit.tank_low);
    }
}

/// Somebody pushes, and the camera sees what it likes.
struct Rough {
    push: [f64; 6],
    turn_rate: f64,
    view: [f64; 2],
}

impl TactileDisturbance for Rough {
    fn vision(&mut self, time_s: f64, mut normal: VisionInput) -> Option<VisionInput> {
        let axis = Vector3::new(self.view[0], self.view[1], 0.0) * (3.0 * time_s).sin();
        normal.normal = (normal.normal + axis.cross(&normal.normal)).normalize();
        Some(normal)
    }

    fn push(&mut self, time_s: f64) -> Vector6<f64> {
        Vector6::from(self.push) * (self.turn_rate * time_s).sin()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]
    #[test]
    fn the_port_is_passive_whatever_the_world_and_the_policy(
        stiffness in 5e3f64..1e5, friction in 0.0f64..0.7, force in 3.0f64..30.0, radius in 0.01f64..0.06, rate in -3.0f64..3.0,
        push in prop::array::uniform3(-15.0f64..15.0), twist in prop::array::uniform3(-2.0f64..2.0), turn_rate in 0.5f64..20.0,
        view in prop::array::uniform2(-0.3f64..0.3), energy in 1.5f64..32.0, paper: bool, seed in 0u64..1000) {
        let preset = if paper { "paper" } else { "default" };
        let set = [
            format!("controller=\"{preset}\""),
            format!("seed={seed}"),
            format!("plant.contact.stiffness_n_per_m={stiffness}"),
            format!("plant.contact.friction.coulomb_coefficient={friction}"),
            format!("plant.contact.friction.static_coefficient={}", friction * 1.1),
            format!("task.force.reference_n={force}"),
            format!("task.path.radius_m={radius}"),
            format!("task.path.turn_rate_rad_per_s={}", if rate.abs() < 0.3 { 0.3 } else { rate }),
            format!("control.tanks.motion.initial_j={energy}"),
            "limits.force_max_n=500.0".to_owned(),
            "limits.torque_max_nm=100.0".to_owned(),
            "task.path.duration_s=4.0".to_owned(),
            "duration_s=14.0".to_owned(),
        ];
        let mut set: Vec<&str> = set.iter().map(String::as_str).collect();
        set.extend(EXACT);
        let mut rough = Rough { push: [push[0], push[1], push[2], twist[0], twist[1], twist[2]], turn_rate, view };
        let (mut start, mut worst) = (None, f64::NEG_INFINITY);
        let (mut low, mut high, mut force_low, mut force_high) = (f64::INFINITY, 0.0_f64, f64::INFINITY, 0.0_f64);
        let mut short = 0.0_f64;
        // The plant's end stops take a joint's speed without asking the others: what happens there is not mechanics.
        let mut at_a_stop = false;
        evaluate_tactile_with(&scenario(&set), &mut rough, |c| {
            let (arm, books) = (c.plant.arm(), c.output.tanks);
            let limits = arm.model().limits();
            at_a_stop |= (0..7).any(|i| {
                arm.q[i] - limits.position_lower[i] < 0.01 || limits.position_upper[i] - arm.q[i] < 0.01
            });
            let stored = arm.model().kinetic_energy(&arm.q, &arm.qd) + arm.model().potential_energy(&arm.q)
                + books.motion_j + books.force_j;
            // Gravity's compensation lifts the arm: what it did is in the motors' work and not in the law's.
            let lifted = c.plant.energy().motors_j - books.work_j;
            let inside = stored - lifted - c.plant.energy().environment_j;
            let first = *start.get_or_insert(inside);
            if !at_a_stop {
                worst = worst.max(inside - first);
            }
            (low, high) = (low.min(books.motion_j), high.max(books.motion_j));
            (force_low, force_high) = (force_low.min(books.force_j), force_high.max(books.force_j));
            short = short.max(books.short_j);
        }).unwrap();
        prop_assert!(low >= 1.0 && high <= 32.0 && force_low >= 1.0 && force_high <= 2.0, "{low} {high} {force_low} {force_high}");
        prop_assert!(short == 0.0, "short of {short} J");
        // The integration of the plant itself is good to a few hundredths of a joule over thousands of contacts.
        prop_assert!(worst < 0.05, "{worst} J from nowhere");
    }
}

/// What the torque does in one period while something happens to the camera.
struct Eye<F: FnMut(f64, VisionInput) -> Option<VisionInput>>(F);

impl<F: FnMut(f64, VisionInput) -> Option<VisionInput>> TactileDisturbance for Eye<F> {
    fn vision(&mut self, time_s: f64, normal: VisionInput) -> Option<VisionInput> {
        (self.0)(time_s, normal)
    }
}

fn steepest(preset: &str, disturbance: &mut dyn TactileDisturbance) -> (f64, Evaluation) {
    let set = [preset, "task.path.duration_s=10.0"];
    let (mut last, mut worst): (Option<Joints<7>>, f64) = (None, 0.0);
    let mut sliding = 0;
    let e = evaluate_tactile_with(&scenario(&set), disturbance, |c| {
        sliding = if c.output.phase == Phase::Slide {
            sliding + 1
        } else {
            0
        };
        if let Some(before) = last.filter(|_| sliding > 1) {
            worst = worst.max((c.output.torque - before).amax());
        }
        last = Some(c.output.torque);
    })
    .unwrap();
    (worst, e)
}

#[test]
fn no_step_in_torque_when_vision_comes_goes_or_jumps() {
    for preset in ["controller=\"default\"", "controller=\"paper\""] {
        let mut jump = Eye(|t: f64, mut n: VisionInput| {
            if (16.0..16.6).contains(&t) {
                n.normal = (n.normal + Vector3::new(0.25, 0.2, 0.0)).normalize();
            }
            Some(n)
        });
        let mut gone = Eye(|t: f64, n| (!(16.0..16.25).contains(&t)).then_some(n));
        let mut late = Eye(|t: f64, n| (t > 1.0).then_some(n));
        for (name, eye) in [
            ("nothing", &mut Calm as &mut dyn TactileDisturbance),
            ("jumps", &mut jump),
            ("goes and comes", &mut gone),
            ("comes late", &mut late),
        ] {
            let (worst, e) = steepest(preset, eye);
            assert_eq!((e.phase, e.fault), ("done", None), "{name}");
            // A step of the reference would ask for all that the motors can change in a period, 1 Nm.
            assert!(worst < 0.35, "{preset}, {name}: {worst} Nm");
        }
    }
}

#[test]
fn without_a_camera_touch_alone_goes_on() {
    let mut dark = Eye(|_, _| None);
    let e = evaluate_tactile_with(&scenario(&["seed=4"]), &mut dark, |_| ()).unwrap();
    assert_eq!((e.phase, e.fault), ("done", None));
    let force = e.figures.force;
    assert!(force.rmse_n.unwrap() < 2.5, "{force:?}");
    assert!(e.figures.tool_error_deg.unwrap().mean < 4.0);
}

struct Wrench<F: FnMut(&mut UnifiedInput)>(F);

impl<F: FnMut(&mut UnifiedInput)> TactileDisturbance for Wrench<F> {
    fn input(&mut self, input: &mut UnifiedInput) {
        (self.0)(input);
    }
}

#[test]
fn a_wrench_that_falls_silent_or_is_no_number_stops_and_retracts() {
    for case in 0..3 {
        let mut seen = Vec::new();
        let mut bad = Wrench(move |input: &mut UnifiedInput| {
            if input.time_s >= 9.0 {
                match case {
                    0 => input.wrench_age_s = input.time_s - 9.0 + 0.005,
                    1 => input.wrench.force.x = f64::NAN,
                    _ => input.wrench_validity = Validity::SensorError,
                }
            }
        });
        let e = evaluate_tactile_with(&scenario(&[]), &mut bad, |c| {
            if c.input.time_s >= 9.003 && c.input.time_s < 9.05 {
                seen.push(c.output.phase);
            }
        })
        .unwrap();
        assert_eq!(e.phase, "fault", "{case}");
        assert!(e.fault.is_some());
        assert!(
            seen.iter()
                .all(|p| matches!(p, Phase::Hold | Phase::Retract)),
            "{case}: {seen:?}"
        );
        assert!(e.figures.force.peak_n.unwrap() < 25.0);
    }
}

#[test]
fn an_arm_state_that_is_no_number_keeps_the_last_torque() {
    let mut torques = Vec::new();
    let mut bad = Wrench(|input: &mut UnifiedInput| {
        if input.time_s >= 9.0 {
            input.q[2] = f64::NAN;
        }
    });
    let e = evaluate_tactile_with(&scenario(&["duration_s=9.2"]), &mut bad, |c| {
        torques.push(c.output.torque);
    })
    .unwrap();
    assert_eq!(e.phase, "fault");
    let n = torques.len();
    assert!(torques[n - 1].iter().all(|x| x.is_finite()));
    assert_eq!(torques[n - 1], torques[n - 20]);
}

/// The surface under the tool is gone for a moment: somebody lifts the arm off it.
struct Lift;

impl TactileDisturbance for Lift {
    fn push(&mut self, time_s: f64) -> Vector6<f64> {
        if (10.0..10.5).contains(&time_s) {
            Vector6::new(0.0, 0.0, 25.0, 0.0, 0.0, 0.0)
        } else {
            Vector6::zeros()
        }
    }
}

#[test]
fn contact_lost_is_sought_and_found_again() {
    let mut phases = Vec::new();
    let e = evaluate_tactile_with(&scenario(&[]), &mut Lift, |c| {
        if phases.last() != Some(&c.output.phase) {
            phases.push(c.output.phase);
        }
    })
    .unwrap();
    assert_eq!((e.phase, e.fault), ("done", None), "{phases:?}");
    assert!(e.figures.contact.lost_s < 5.0);
}

#[test]
fn other_worlds_are_wiped_too() {
    for (name, set) in [
        (
            "slippery",
            vec![
                "plant.contact.friction.coulomb_coefficient=0.1",
                "plant.contact.friction.static_coefficient=0.12",
            ],
        ),
        (
            "rough",
            vec![
                "plant.contact.friction.coulomb_coefficient=0.6",
                "plant.contact.friction.static_coefficient=0.65",
            ],
        ),
        ("soft", vec!["plant.contact.stiffness_n_per_m=20000.0"]),
        ("stiff", vec!["plant.contact.stiffness_n_per_m=100000.0"]),
        (
            "steeper",
            vec![
                "plant.surface.amplitude_m=0.025",
                "plant.surface.wavelength_m=0.36",
            ],
        ),
        ("other phase", vec!["plant.surface.phase_rad=2.2"]),
        ("light", vec!["task.force.reference_n=8.0"]),
        ("firm", vec!["task.force.reference_n=25.0"]),
    ] {
        let mut set = set;
        set.push("seed=33");
        let e = run(&set);
        assert_eq!((e.phase, e.fault), ("done", None), "{name}");
        let force = e.figures.force;
        assert!(force.rmse_n.unwrap() < 1.2, "{name}: {force:?}");
        let path = e.figures.path.mad_xyz_m.unwrap();
        assert!(path.iter().all(|x| *x < 0.002), "{name}: {path:?}");
    }
}
