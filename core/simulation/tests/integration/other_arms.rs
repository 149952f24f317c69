//! The torque laws on arms with another number of joints than those they were published for: the
//! object task on a Panda with seven joints, the visuo-tactile task on an arm with six.

// A whole file of tests: what fails here is the test.
use tangent_control::Phase;
use tangent_simulation::{
    Evaluation, ObjectScenario, Undisturbed, VisuoTactileScenario, evaluate_object,
    evaluate_object_of, evaluate_visuo_tactile_of,
};

const OBJECT: &str = include_str!("../../../../scenarios/lippiello/lippiello_plane.toml");
const WAVE: &str = include_str!("../../../../scenarios/karacan/karacan_wave.toml");

/// The object task within reach of a Panda, with the friction of its joints.
const PANDA: [&str; 8] = [
    "plant.robot=\"panda\"",
    "plant.surface.position_m=[0.5, 0.05, 0.2]",
    "plant.start.near_m=[0.45, 0.05, 0.2]",
    "plant.arm.viscous_nm_s_per_rad=[0.12]",
    "control.friction.viscous_nm_s_per_rad=[0.12]",
    "task.path.radius_m=0.05",
    "task.path.speed_m_per_s=0.0415",
    "duration_s=30.0",
];

/// The visuo-tactile task within reach of the arm with six joints.
const SIX: [&str; 6] = [
    "plant.robot=\"smart3s_substitute\"",
    "plant.arm.coulomb_nm=[0.0]",
    "control.friction.coulomb_nm=[0.0]",
    "plant.surface.position_m=[0.9, 0.05, 0.6]",
    "plant.start.near_m=[0.9, 0.05, 0.65]",
    "task.path.duration_s=6.0",
];

fn overrides(set: &[&str]) -> Vec<String> {
    set.iter().map(|&set| set.to_owned()).collect()
}

/// Mean and standard deviation of the true pressing forces while the tool slides, N.
fn mean_and_sd(forces: &[f64]) -> (f64, f64) {
    let n = forces.len() as f64;
    let mean = forces.iter().sum::<f64>() / n;
    let square = forces.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / n;
    (mean, square.sqrt())
}

fn ended_well(run: &Evaluation) {
    assert_eq!((run.phase, run.fault), ("done", None), "{run:?}");
}

#[test]
fn hybrid_dynamics_holds_its_force_with_seven_joints() {
    let scenario = ObjectScenario::parse("panda", OBJECT, &overrides(&PANDA)).unwrap();
    let (mut forces, mut spare_max) = (Vec::new(), 0.0_f64);
    let run = evaluate_object_of::<7>(&scenario, &mut Undisturbed, |c| {
        if c.output.phase == Phase::Slide {
            forces.push(c.truth.wrench.force.dot(&c.truth.normal));
            spare_max = spare_max.max(c.input.qd.amax());
        }
    })
    .unwrap();
    ended_well(&run);
    let (mean, sd) = mean_and_sd(&forces);
    let wanted = scenario.task.force.reference_n;
    assert!((mean - wanted).abs() < 0.2 && sd < 0.5, "{mean} ± {sd} N");
    // The redundant joint does not drift: no joint is faster than the path requires.
    assert!(spare_max < 0.5, "{spare_max} rad/s");
    // `evaluate` takes the number of joints from the model.
    let again = evaluate_object(&scenario).unwrap();
    assert_eq!(again.state_digest, run.state_digest);
}

#[test]
fn unified_force_impedance_holds_its_force_with_six_joints() {
    let scenario = VisuoTactileScenario::parse("six", WAVE, &overrides(&SIX)).unwrap();
    let mut forces = Vec::new();
    let run = evaluate_visuo_tactile_of::<6>(&scenario, &mut Undisturbed, |c| {
        if c.output.phase == Phase::Slide {
            forces.push(c.truth.wrench.force.dot(&c.truth.normal));
        }
    })
    .unwrap();
    ended_well(&run);
    let (mean, sd) = mean_and_sd(&forces);
    let wanted = scenario.task.force.reference_n;
    assert!((mean - wanted).abs() < 1.0 && sd < 2.5, "{mean} ± {sd} N");
    assert_eq!(run.tactile.unwrap().short_j, Some(0.0));
}
