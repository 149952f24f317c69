//! What a cell file states is what laws and estimators are told, whatever the plant's errors are.

use tangent_simulation::{
    ObjectScenario, TorqueErrors, VisuoTactileScenario, evaluate_object, evaluate_visuo_tactile,
};

const OBJECT: &str = include_str!("../../../../scenarios/lippiello/lippiello_plane.toml");
const TACTILE: &str = include_str!("../../../../scenarios/karacan/karacan_wave.toml");

/// Errors of every kind that a torque-controlled cell has.
const ERRORS: [&str; 10] = [
    "plant.tool.payload_error={mass_kg=0.05, com_in_sensor_m=[0.001, -0.001, 0.002]}",
    "plant.errors.frames.tip_position_m=[0.0005, -0.0005, 0.001]",
    "plant.errors.frames.tip_rotation_rad=[0.005, 0.0, 0.01]",
    "plant.errors.frames.sensor_rotation_rad=[0.01, 0.0, -0.01]",
    "plant.errors.arm.delay_periods=1",
    "plant.errors.arm.offset_rad=[0.0001, -0.0001, 0.0001, 0.0, 0.0001, -0.0002]",
    "plant.errors.arm.static_ratio=1.3",
    "plant.errors.arm.asymmetry=0.05",
    "plant.errors.external_wrench.gain_ratio=0.8",
    "plant.errors.friction={relative=0.2, wavelength_m=0.05}",
];

fn overrides(keys: &[&str]) -> Vec<String> {
    keys.iter().map(|&key| key.to_owned()).collect()
}

fn object(keys: &[&str]) -> ObjectScenario {
    ObjectScenario::parse("object", OBJECT, &overrides(keys)).unwrap()
}

fn tactile(keys: &[&str]) -> VisuoTactileScenario {
    VisuoTactileScenario::parse("tactile", TACTILE, &overrides(keys)).unwrap()
}

#[test]
fn the_stated_cell_does_not_depend_on_the_errors() {
    let (exact, wrong) = (object(&[]), object(&ERRORS));
    assert_ne!(exact.plant.errors, wrong.plant.errors);
    assert_eq!(exact.plant.errors, TorqueErrors::default());
    let [a, b] = [&exact, &wrong].map(|s| s.plant.stated::<6>().unwrap());
    assert_eq!(a.flange_from_tool, b.flange_from_tool);
    assert_eq!(a.flange_from_sensor, b.flange_from_sensor);
    assert_eq!(a.interface, b.interface);
    assert_eq!(a.arm.gravity(&a.arm.home()), b.arm.gravity(&b.arm.home()));
    let [a, b] = [tactile(&[]), tactile(&ERRORS)].map(|s| s.plant.stated::<7>().unwrap());
    assert_eq!(a.interface, b.interface);
    assert_eq!(a.arm.gravity(&a.arm.home()), b.arm.gravity(&b.arm.home()));
}

#[test]
fn every_error_changes_the_run_and_none_of_them_ends_it() {
    let exact = evaluate_object(&object(&[])).unwrap();
    let tactile_exact = evaluate_visuo_tactile(&tactile(&[])).unwrap();
    for error in ERRORS {
        // A frictionless plane without a payload has nothing to vary.
        if !error.contains("external_wrench") && !error.contains("errors.friction") {
            let run = evaluate_object(&object(&[error])).unwrap();
            assert_eq!((run.phase, run.fault), ("done", None), "{error}");
            // Joints without friction have none that could follow another law.
            let smooth = error.contains("static_ratio") || error.contains("asymmetry");
            assert_eq!(run.state_digest == exact.state_digest, smooth, "{error}");
        }
        // There is no force sensor in this cell.
        if !error.contains("sensor_rotation") {
            let run = evaluate_visuo_tactile(&tactile(&[error])).unwrap();
            assert_eq!((run.phase, run.fault), ("done", None), "{error}");
            assert_ne!(run.state_digest, tactile_exact.state_digest, "{error}");
        }
    }
}

#[test]
fn an_error_out_of_its_range_is_refused_with_its_key() {
    for (error, key) in [
        ("plant.errors.arm.asymmetry=2.0", "errors.arm.asymmetry"),
        (
            "plant.errors_drawn.friction_variation=0.2",
            "errors_drawn.friction_wavelength_m",
        ),
        (
            "plant.errors_drawn.payload_kg=-1.0",
            "errors_drawn.payload_kg",
        ),
    ] {
        let refusal = evaluate_object(&object(&[error])).unwrap_err();
        assert!(refusal.to_string().contains(key), "{refusal}");
    }
}

#[test]
fn errors_drawn_from_the_seed_differ_between_seeds_and_repeat_with_one() {
    let drawn = [
        "plant.errors_drawn.joint_offset_rad=0.0001",
        "plant.camera.noise_px=0.0",
    ];
    let run = |seed: &str| {
        let keys = [&drawn[..], &[seed]].concat();
        evaluate_object(&object(&keys)).unwrap().state_digest
    };
    assert_eq!(run("seed=4"), run("seed=4"));
    assert_ne!(run("seed=4"), run("seed=5"));
}
