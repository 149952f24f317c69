//! Energy of `unified_force_impedance` in closed loop: its energy balance compared with the
//! plant's, its tanks, and the port to the environment.

// A whole file of tests: what fails here is the test.
use crate::energy_balance::{Balance, EXACT};
use crate::tactile_cells::scenario;
use tangent_control::Phase;
use tangent_mechanics::Joints;
use tangent_simulation::{
    Undisturbed, VisuoTactileCycle, evaluate_visuo_tactile, evaluate_visuo_tactile_with,
};

/// Energy balance of a run: the energy through the plant's ports, compared with the law's own.
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

    fn see(&mut self, c: &VisuoTactileCycle<'_>) {
        let plant = c.plant;
        let arm = plant.arm();
        // The law's energy balance excludes gravity compensation. Its work is computed by the same
        // rule, a period later, when the torque acts.
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
        // Work according to the law, compared with the plant's.
        let by_motors = energy.motors_j - self.gravity_j;
        self.worst_books_j = self.worst_books_j.max((by_motors - books.work_j).abs());
        // The tanks hold the energy that was neither transferred as work nor dissipated.
        let held = tanks_0 - books.work_j - books.dissipated_j + books.short_j;
        self.worst_tanks_j = self.worst_tanks_j.max((tanks - held).abs());
        self.tank_low = self.tank_low.min(books.motion_j).min(books.force_j);
    }
}

#[test]
fn the_energy_books_close_against_the_plants_to_a_microjoule() {
    for preset in ["controller=\"default\"", "controller=\"paper\""] {
        let mut set = EXACT.to_vec();
        set.push(preset);
        let mut audit = Audit::new();
        let e = evaluate_visuo_tactile_with(&scenario(&set), &mut Undisturbed, |c| audit.see(c))
            .unwrap();
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

#[test]
fn no_joule_comes_from_nowhere_or_goes_there() {
    for preset in ["default", "paper"] {
        let preset = format!("controller=\"{preset}\"");
        let worst = [4, 16].map(|steps| {
            let steps = format!("plant.arm.sub_steps={steps}");
            let mut set = EXACT.to_vec();
            set.extend([preset.as_str(), steps.as_str()]);
            let mut balance = Balance::default();
            evaluate_visuo_tactile_with(&scenario(&set), &mut Undisturbed, |c| balance.see(c))
                .unwrap();
            assert!(!balance.at_a_stop);
            balance.worst_j
        });
        // The remaining difference is the plant's integration error: with four times as many steps
        // it is a fourth.
        assert!(
            worst[1] < 0.35 * worst[0] && worst[0] < 0.05,
            "{preset}: {worst:?}"
        );
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
            let e = evaluate_visuo_tactile_with(&scenario(&set), &mut Undisturbed, |c| {
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
            // The motors can change the torque by at most 1 Nm in a period.
            assert!(worst < 0.35, "{preset} {start}: {worst} Nm");
            let limited = e.tactile.unwrap().limited_cycles.unwrap();
            assert!(limited < 100, "{preset} {start}: {limited} periods");
        }
    }
}

#[test]
fn a_task_that_takes_more_energy_than_it_has_ends_with_that_reason() {
    let e = evaluate_visuo_tactile(&scenario(&["control.tanks.motion.initial_j=3.0"])).unwrap();
    assert_eq!(e.phase, "fault");
    assert!(
        e.fault.unwrap().contains("motion tank empty"),
        "{:?}",
        e.fault
    );
}
