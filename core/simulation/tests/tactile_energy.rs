//! Energy of `unified_force_impedance` in closed loop: its books against the plant's, its tanks, and the port to the world.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

mod tactile_cells;

use std::cell::Cell;

use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use tactile_cells::scenario;
use tangent_control::{Phase, VisionInput};
use tangent_mechanics::Joints;
use tangent_simulation::{
    Calm, TactileCycle, TactileDisturbance, evaluate_tactile, evaluate_tactile_with,
};

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

/// Joules inside arm and tanks that did not come in through a port, and what was taken out, since the start: all of it is zero where
/// nothing is made from nothing.
#[derive(Default)]
struct Balance {
    start_j: Option<f64>,
    worst_j: f64,
    at_a_stop: bool,
    /// Through the world's port until the period before, and all that went through it either way.
    environment_j: f64,
    turnover_j: f64,
}

impl Balance {
    fn see(&mut self, c: &TactileCycle<'_>) {
        let (arm, books, ports) = (c.plant.arm(), c.output.tanks, c.plant.energy());
        let model = arm.model();
        let limits = model.limits();
        // The plant's end stops take a joint's speed without asking the others: what happens there is not mechanics.
        self.at_a_stop |= (0..7).any(|i| {
            arm.q[i] - limits.position_lower[i] < 0.01 || limits.position_upper[i] - arm.q[i] < 0.01
        });
        let inside = model.kinetic_energy(&arm.q, &arm.qd)
            + model.potential_energy(&arm.q)
            + books.motion_j
            + books.force_j;
        // Gravity's compensation lifts the arm: what it did is in the motors' work and not in the law's.
        let came = (ports.motors_j - books.work_j) + ports.environment_j + books.short_j;
        let went = ports.friction_j + books.dissipated_j;
        let sum = inside - came + went;
        self.turnover_j += (ports.environment_j - self.environment_j).abs();
        self.environment_j = ports.environment_j;
        let start = *self.start_j.get_or_insert(sum);
        if !self.at_a_stop {
            self.worst_j = self.worst_j.max((sum - start).abs());
        }
    }
}

#[test]
fn no_joule_comes_from_nowhere_or_goes_there() {
    for preset in ["default", "paper"] {
        let preset = format!("controller=\"{preset}\"");
        let worst = [4, 16].map(|steps| {
            let steps = format!("plant.arm.sub_steps={steps}");
            let mut set = EXACT.to_vec();
            set.extend([preset.as_str(), steps.as_str()]);
            let mut balance = Balance::default();
            evaluate_tactile_with(&scenario(&set), &mut Calm, |c| balance.see(c)).unwrap();
            assert!(!balance.at_a_stop);
            balance.worst_j
        });
        // What is left is the plant's integration: four times as many steps, a fourth of it.
        assert!(
            worst[1] < 0.35 * worst[0] && worst[0] < 0.05,
            "{preset}: {worst:?}"
        );
    }
}

/// Any world, any policy, any lie of the camera, any energy at the start.
#[allow(clippy::type_complexity)]
fn anything() -> impl Strategy<
    Value = (
        (f64, f64, f64, f64, f64),
        ([f64; 3], [f64; 3], f64, [f64; 2]),
        (f64, f64, bool, u64),
    ),
> {
    (
        (
            5e3f64..2e5,
            0.0f64..0.7,
            3.0f64..30.0,
            0.01f64..0.06,
            -3.0f64..3.0,
        ),
        (
            prop::array::uniform3(-15.0f64..15.0),
            prop::array::uniform3(-2.0f64..2.0),
            0.5f64..20.0,
            prop::array::uniform2(-0.3f64..0.3),
        ),
        (1.5f64..32.0, 1.2f64..2.0, any::<bool>(), 0u64..1000),
    )
}

const CASES: u32 = 24;

#[test]
fn the_port_is_passive_whatever_the_world_and_the_policy() {
    let slid = Cell::new(0);
    let mut runner = TestRunner::new(ProptestConfig {
        cases: CASES,
        failure_persistence: None,
        ..ProptestConfig::default()
    });
    runner
        .run(&anything(), |(world, rough, start)| {
            let (stiffness, friction, force, radius, rate) = world;
            let (push, twist, turn_rate, view) = rough;
            let (motion_j, force_j, paper, seed) = start;
            let rate = if rate.abs() < 0.3 { 0.3 } else { rate };
            let set = [
                format!("controller=\"{}\"", if paper { "paper" } else { "default" }),
                format!("seed={seed}"),
                format!("plant.contact.stiffness_n_per_m={stiffness}"),
                format!("plant.contact.friction.coulomb_coefficient={friction}"),
                format!(
                    "plant.contact.friction.static_coefficient={}",
                    friction * 1.1
                ),
                format!("task.force.reference_n={force}"),
                format!("task.path.radius_m={radius}"),
                format!("task.path.turn_rate_rad_per_s={rate}"),
                format!("control.tanks.motion.initial_j={motion_j}"),
                format!("control.tanks.force.initial_j={force_j}"),
                "plant.arm.sub_steps=8".to_owned(),
                "control.touch.align_s=2.0".to_owned(),
                "control.monitor.rate_per_s=8.0".to_owned(),
                "limits.force_max_n=500.0".to_owned(),
                "limits.torque_max_nm=100.0".to_owned(),
                "task.path.duration_s=4.0".to_owned(),
                "duration_s=16.0".to_owned(),
            ];
            let mut set: Vec<&str> = set.iter().map(String::as_str).collect();
            set.extend(EXACT);
            let mut rough = Rough {
                push: [push[0], push[1], push[2], twist[0], twist[1], twist[2]],
                turn_rate,
                view,
            };
            let mut balance = Balance::default();
            let (mut motion, mut pressing) = (Span::default(), Span::default());
            let (mut short, mut slides) = (0.0_f64, false);
            evaluate_tactile_with(&scenario(&set), &mut rough, |c| {
                balance.see(c);
                motion.see(c.output.tanks.motion_j);
                pressing.see(c.output.tanks.force_j);
                short = short.max(c.output.tanks.short_j);
                slides |= c.output.phase == Phase::Slide;
            })
            .unwrap();
            slid.set(slid.get() + u32::from(slides));
            prop_assert!(motion.within(1.0, 32.0), "{motion:?}");
            prop_assert!(pressing.within(1.0, 2.0), "{pressing:?}");
            prop_assert!(short == 0.0, "short of {short} J");
            // What the integration of the plant itself is good to, as the test above shows.
            let most = 0.02 + 0.01 * balance.turnover_j;
            prop_assert!(
                balance.worst_j < most,
                "{} J of {}",
                balance.worst_j,
                balance.turnover_j
            );
            Ok(())
        })
        .unwrap();
    assert!(slid.get() * 2 > CASES, "only {} slid", slid.get());
}

/// Least and greatest of something.
#[derive(Debug)]
struct Span(f64, f64);

impl Default for Span {
    fn default() -> Self {
        Self(f64::INFINITY, f64::NEG_INFINITY)
    }
}

impl Span {
    fn see(&mut self, value: f64) {
        *self = Self(self.0.min(value), self.1.max(value));
    }

    fn within(&self, least: f64, most: f64) -> bool {
        self.0 >= least && self.1 <= most
    }
}

#[test]
fn a_tank_at_its_limit_cuts_the_action_smoothly() {
    for preset in ["default", "paper"] {
        let preset = format!("controller=\"{preset}\"");
        for (tank, energy) in [
            ("force", 1.1),
            ("force", 1.2),
            ("motion", 2.5),
            ("motion", 4.0),
        ] {
            let start = format!("control.tanks.{tank}.initial_j={energy}");
            let (mut last, mut worst, mut shut): (Option<Joints<7>>, f64, bool) =
                (None, 0.0, false);
            let set = [
                &preset,
                &start,
                "task.path.duration_s=10.0",
                "duration_s=30.0",
            ];
            let e = evaluate_tactile_with(&scenario(&set), &mut Calm, |c| {
                let tanks = c.output.tanks;
                shut |= if tank == "force" {
                    tanks.force_j < 1.25
                } else {
                    tanks.motion_j < 2.0
                };
                if c.output.phase != Phase::Slide {
                    last = None;
                    return;
                }
                if let Some(before) = last.replace(c.output.torque) {
                    worst = worst.max((c.output.torque - before).amax());
                }
            })
            .unwrap();
            assert!(shut, "{preset} {start}");
            // All that the motors can change in a period is 1 Nm.
            assert!(worst < 0.35, "{preset} {start}: {worst} Nm");
            let limited = e.tactile.unwrap().limited_cycles.unwrap();
            assert!(limited < 100, "{preset} {start}: {limited} periods");
        }
    }
}

#[test]
fn a_task_that_takes_more_energy_than_it_has_ends_with_that_reason() {
    let e = evaluate_tactile(&scenario(&["control.tanks.motion.initial_j=3.0"])).unwrap();
    assert_eq!(e.phase, "fault");
    assert!(
        e.fault.unwrap().contains("motion tank empty"),
        "{:?}",
        e.fault
    );
}
