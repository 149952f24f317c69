//! A frozen sensor whose records keep arriving: the true force, from the simulator, stays bounded.

// The test prints its results, and reads the scenarios of the repository.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
use tangent_control::{Fault, Phase, UnifiedInput};
use tangent_mechanics::{Tool, Wrench};
use tangent_sensing::Validity;
use tangent_simulation::{
    AdmittanceScenario, Disturbance, ObjectScenario, Undisturbed, VisuoTactileScenario,
    evaluate_admittance_with, evaluate_object_with, evaluate_visuo_tactile_with, no_files,
};

/// The larger of twice the reference and 10 N.
const FORCE_MAX_N: f64 = 10.0;

pub(crate) fn scenario(name: &str, settings: &[String]) -> AdmittanceScenario {
    let file = format!("{}/../../scenarios/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&file).unwrap();
    AdmittanceScenario::parse(name, &text, settings, &no_files).unwrap()
}

/// Settings of a surface with this stiffness (N/m) under a standard ATI Gamma (steps of a
/// micronewton, noise of a few hundredths of a newton), or under a sensor without noise.
pub(crate) fn settings(stiffness: f64, noisy: bool) -> Vec<String> {
    let mut all = vec![
        format!("plant.contact.stiffness_n_per_m={stiffness:.1}"),
        "duration_s=30".to_owned(),
    ];
    if noisy {
        all.push("plant.sensor.noise_n_per_sqrt_hz=0.002".to_owned());
        all.push("plant.sensor.noise_nm_per_sqrt_hz=6e-5".to_owned());
    }
    all
}

/// True state during one run.
pub(crate) struct Seen {
    /// Start times of the phases, s.
    pub contact_s: f64,
    pub slide_s: f64,
    /// Largest true pressing force from the fault on, N.
    pub peak_n: f64,
    /// Fault that ended the task, and time at which the tool began to leave because of it.
    pub fault: Option<Fault>,
    pub left_s: Option<f64>,
    /// Distance that the tool moved from the fault until then, m.
    pub way_m: f64,
}

pub(crate) fn run(scenario: &AdmittanceScenario, fault_s: f64) -> Seen {
    let mut seen = Seen {
        contact_s: f64::INFINITY,
        slide_s: f64::INFINITY,
        peak_n: 0.0,
        fault: None,
        left_s: None,
        way_m: 0.0,
    };
    let mut last = None;
    let evaluation = evaluate_admittance_with(scenario, |cycle| {
        let time_s = cycle.input.time_s;
        let at = cycle.truth.base_from_tool.translation();
        match cycle.output.phase {
            Phase::Contact => seen.contact_s = seen.contact_s.min(time_s),
            Phase::Slide => seen.slide_s = seen.slide_s.min(time_s),
            Phase::Retract if cycle.output.fault.is_some() => {
                seen.left_s = seen.left_s.or(Some(time_s));
            }
            // Lifts off to prove the zero.
            Phase::Clear if seen.contact_s.is_finite() => {
                seen.left_s = seen.left_s.or(Some(time_s));
            }
            _ => {}
        }
        if time_s >= fault_s {
            let force_n = cycle.truth.wrench.force.dot(&cycle.truth.normal);
            seen.peak_n = seen.peak_n.max(force_n);
            if seen.left_s.is_none() {
                seen.way_m += last.map_or(0.0, |last: nalgebra::Vector3<f64>| (at - last).norm());
            }
        }
        last = Some(at);
        seen.fault = cycle.output.fault.or(seen.fault);
    })
    .unwrap();
    assert!(evaluation.steps > 0);
    seen
}

pub(crate) fn with_fault(
    name: &str,
    stiffness: f64,
    noisy: bool,
    fault: &str,
) -> AdmittanceScenario {
    let mut all = settings(stiffness, noisy);
    all.push(format!("plant.sensor.fault={fault}"));
    scenario(name, &all)
}

pub(crate) const SURFACES: [&str; 3] = ["pipe_ideal", "sphere", "plane"];
const STIFFNESSES: [f64; 4] = [5e3, 1e4, 2.5e4, 5e4];

/// Times at which the sensor freezes: while the force builds up, at the start of the path, and
/// while the tool slides.
fn moments(calm: &Seen) -> [f64; 4] {
    [
        calm.contact_s + 0.05,
        calm.contact_s + 0.3,
        calm.slide_s + 0.2,
        calm.slide_s + 2.5,
    ]
}

#[test]
fn a_frozen_sensor_never_hides_more_than_ten_newtons() {
    let mut worst: f64 = 0.0;
    for name in SURFACES {
        for stiffness in STIFFNESSES {
            let calm = run(&scenario(name, &settings(stiffness, true)), 0.0);
            assert_eq!(calm.fault, None, "{name} {stiffness}: {:?}", calm.fault);
            for from_s in moments(&calm) {
                let frozen = format!("{{ kind = \"frozen\", from_s = {from_s} }}");
                let seen = run(&with_fault(name, stiffness, true, &frozen), from_s);
                let what = format!("{name}, {stiffness} N/m, from {from_s:.3} s");
                assert_eq!(seen.fault, Some(Fault::Wrench(Validity::Frozen)), "{what}");
                let late_s = seen.left_s.unwrap() - from_s;
                assert!(late_s <= 2.0 * 0.008 + 1e-9, "{what}: {late_s} s");
                assert!(seen.peak_n <= FORCE_MAX_N, "{what}: {} N", seen.peak_n);
                worst = worst.max(seen.peak_n);
            }
        }
    }
    println!("worst true force {worst:.2} N");
}

#[test]
fn a_stuck_axis_never_hides_more_than_ten_newtons() {
    for name in SURFACES {
        for stiffness in STIFFNESSES {
            let calm = run(&scenario(name, &settings(stiffness, true)), 0.0);
            for from_s in moments(&calm) {
                for axis in [0, 2] {
                    let stuck =
                        format!("{{ kind = \"stuck_axis\", axis = {axis}, from_s = {from_s} }}");
                    let seen = run(&with_fault(name, stiffness, true, &stuck), from_s);
                    let what = format!("{name}, {stiffness} N/m, axis {axis} from {from_s:.3} s");
                    assert_eq!(
                        seen.fault,
                        Some(Fault::Wrench(Validity::AxisStuck)),
                        "{what}"
                    );
                    let late_s = seen.left_s.unwrap() - from_s;
                    assert!(late_s <= 2.0 * 0.008 + 1e-9, "{what}: {late_s} s");
                    assert!(seen.peak_n <= FORCE_MAX_N, "{what}: {} N", seen.peak_n);
                }
            }
        }
    }
}

/// A sensor without noise has no statistics to learn. The fault is detected because the tool moves
/// while the reading does not.
#[test]
fn a_frozen_sensor_without_noise_is_noticed_within_two_millimetres() {
    let mut worst: (f64, f64) = (0.0, 0.0);
    for name in SURFACES {
        for stiffness in STIFFNESSES {
            let calm = run(&scenario(name, &settings(stiffness, false)), 0.0);
            assert_eq!(calm.fault, None, "{name} {stiffness}: {:?}", calm.fault);
            for from_s in moments(&calm) {
                let frozen = format!("{{ kind = \"frozen\", from_s = {from_s} }}");
                let seen = run(&with_fault(name, stiffness, false, &frozen), from_s);
                let what = format!("{name}, {stiffness} N/m, from {from_s:.3} s");
                assert!(
                    matches!(
                        seen.fault,
                        Some(Fault::Wrench(Validity::Frozen | Validity::Unresponsive))
                    ),
                    "{what}: {:?}",
                    seen.fault
                );
                assert!(seen.peak_n <= FORCE_MAX_N, "{what}: {} N", seen.peak_n);
                assert!(seen.way_m <= 2e-3, "{what}: {} m", seen.way_m);
                worst = (worst.0.max(seen.peak_n), worst.1.max(seen.way_m));
            }
        }
    }
    println!(
        "worst true force {:.2} N, way {:.2} mm",
        worst.0,
        1e3 * worst.1
    );
}

/// A reading that is too low or delayed is not a standstill. The law and its limits bound the
/// force; the remaining excess is stated here.
#[test]
fn a_zero_that_leaps_and_an_old_reading_stay_bounded() {
    for name in SURFACES {
        for stiffness in [5e3, 2.5e4] {
            let calm = run(&scenario(name, &settings(stiffness, true)), 0.0);
            let from_s = calm.slide_s + 0.5;
            for fault in [
                format!("{{ kind = \"slow\", delay_s = 0.05, from_s = {from_s} }}"),
                format!(
                    "{{ kind = \"bias_step\", counts = [0, 0, 2000000, 0, 0, 0], from_s = {from_s} }}"
                ),
            ] {
                let seen = run(&with_fault(name, stiffness, true, &fault), from_s);
                println!(
                    "{name}, {stiffness} N/m, {fault}: {:.2} N, {:?}",
                    seen.peak_n, seen.fault
                );
                assert!(
                    seen.peak_n <= FORCE_MAX_N + 1.5,
                    "{name}, {stiffness} N/m, {fault}: {} N",
                    seen.peak_n
                );
            }
        }
    }
}

/// The torque-controlled arm with a sensor at its wrist: `hybrid_dynamics`, where twice the
/// reference is more than 10 N.
#[test]
fn a_frozen_sensor_of_the_torque_arm_is_noticed_within_two_cycles() {
    for name in ["lippiello_plane", "lippiello_sphere", "lippiello_cylinder"] {
        for from_s in [9.0, 14.0] {
            for fault in [
                format!("{{ kind = \"frozen\", from_s = {from_s} }}"),
                format!("{{ kind = \"stuck_axis\", axis = 2, from_s = {from_s} }}"),
            ] {
                let file = format!(
                    "{}/../../scenarios/lippiello/{name}.toml",
                    env!("CARGO_MANIFEST_DIR")
                );
                let text = std::fs::read_to_string(&file).unwrap();
                let set = format!("plant.sensor.fault={fault}");
                let scenario = ObjectScenario::parse(name, &text, &[set]).unwrap();
                let bound_n = FORCE_MAX_N.max(2.0 * scenario.task.force.reference_n);
                let (mut peak_n, mut left_s, mut pressed) = (0.0_f64, None, false);
                let e = evaluate_object_with(&scenario, &mut Undisturbed, |c| {
                    let time_s = c.input.time_s;
                    pressed |= time_s < from_s && c.output.phase.is_pressing();
                    if time_s >= from_s {
                        peak_n = peak_n.max(c.truth.wrench.force.dot(&c.truth.normal));
                        if c.output.phase == Phase::Retract {
                            left_s = left_s.or(Some(time_s));
                        }
                    }
                })
                .unwrap();
                assert!(pressed, "{name}: nothing was pressed before {from_s} s");
                assert_eq!(e.phase, "fault", "{name} {fault}: {:?}", e.fault);
                assert!(peak_n <= bound_n, "{name} {fault}: {peak_n} N");
                // Two cycles of a robot at 125 Hz. Two cycles of this arm, 1 ms each, would need
                // finer counts.
                let late_s = left_s.unwrap() - from_s;
                assert!(late_s <= 0.016, "{name} {fault}: {late_s} s");
            }
        }
    }
}

/// The robot's own wrench estimate stands still.
struct Frozen {
    from_s: f64,
    held: Option<Wrench<Tool>>,
}

impl Disturbance for Frozen {
    fn input(&mut self, input: &mut UnifiedInput) {
        if input.time_s >= self.from_s {
            input.wrench = *self.held.get_or_insert(input.wrench);
        }
    }
}

/// The arm that estimates contact from its joint torques: `unified_force_impedance`.
#[test]
fn a_frozen_wrench_estimate_is_noticed_within_a_few_cycles() {
    let file = format!(
        "{}/../../scenarios/karacan/karacan_wave.toml",
        env!("CARGO_MANIFEST_DIR")
    );
    let text = std::fs::read_to_string(&file).unwrap();
    let scenario = VisuoTactileScenario::parse("karacan_wave", &text, &[]).unwrap();
    let bound_n = FORCE_MAX_N.max(2.0 * scenario.task.force.reference_n);
    for from_s in [9.0, 12.0] {
        let mut frozen = Frozen { from_s, held: None };
        let (mut peak_n, mut left_s, mut pressed) = (0.0_f64, None, false);
        let e = evaluate_visuo_tactile_with(&scenario, &mut frozen, |c| {
            let time_s = c.input.time_s;
            pressed |= time_s < from_s && c.output.phase.is_pressing();
            if time_s >= from_s {
                peak_n = peak_n.max(c.truth.wrench.force.dot(&c.truth.normal));
                if c.output.phase == Phase::Retract {
                    left_s = left_s.or(Some(time_s));
                }
            }
        })
        .unwrap();
        assert!(pressed, "nothing was pressed before {from_s} s");
        assert_eq!(e.fault, Some(Fault::Wrench(Validity::Frozen).text()));
        assert!(peak_n <= bound_n, "{peak_n} N");
        let late_s = left_s.unwrap() - from_s;
        assert!(late_s <= 0.005, "{late_s} s");
    }
}
