//! The scenarios of the repository: they can be read and run, and the physics is right.

// A whole file of tests: what fails here is the test.
use tangent_simulation::{
    AdmittanceScenario, Evaluation, FileError, ScenarioError, evaluate_admittance,
};

macro_rules! scenarios {
    ($($name:literal),* $(,)?) => {
        const SCENARIOS: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../../../../scenarios/", $name, ".toml")))),*];
    };
}

scenarios!(
    "cone_ideal",
    "cone_realistic",
    "height_field",
    "pipe_ideal",
    "pipe_moving_base",
    "pipe_realistic",
    "pipe_scan",
    "plane",
    "sheet",
    "sphere",
    "torus",
    "touchdown_10kN_per_m",
    "touchdown_1kN_per_m",
    "touchdown_25kN_per_m",
    "touchdown_5kN_per_m",
);

fn read(name: &str) -> Result<String, FileError> {
    match name {
        "height_field.csv" => Ok(include_str!("../../../../scenarios/height_field.csv").to_owned()),
        other => Err(FileError::new(format!("{other} is not there"))),
    }
}

fn parse(name: &str, overrides: &[&str]) -> Result<AdmittanceScenario, ScenarioError> {
    let (_, text) = SCENARIOS.iter().find(|(known, _)| *known == name).unwrap();
    let overrides: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
    AdmittanceScenario::parse(name, text, &overrides, &read)
}

fn run(name: &str, overrides: &[&str]) -> Evaluation {
    evaluate_admittance(&parse(name, overrides).unwrap()).unwrap()
}

fn refused(name: &str, overrides: &[&str]) -> String {
    parse(name, overrides).unwrap_err().to_string()
}

#[test]
fn every_file_of_the_folder_is_read_and_named_as_its_file() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios");
    let mut files: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter_map(|name| name.strip_suffix(".toml").map(str::to_owned))
        .collect();
    files.sort();
    let known: Vec<&str> = SCENARIOS.iter().map(|(name, _)| *name).collect();
    assert_eq!(files, known);
    for name in known {
        assert_eq!(parse(name, &[]).unwrap().name, name);
    }
}

#[test]
fn a_pipe_is_wiped_square_and_at_the_force_asked_for() {
    let result = run("pipe_ideal", &[]);
    assert_eq!((result.phase, result.fault), ("done", None));
    let figures = &result.figures;
    let normal = figures.normal_error_deg.unwrap();
    assert!(normal.mean <= 1.0 && normal.rmse <= 2.0, "{normal:?}");
    assert!(figures.force.rmse_n.unwrap() <= 0.10, "{:?}", figures.force);
    assert_eq!(figures.contact.lost_count, 0);
    assert!(figures.path.rmse_m.unwrap() < 0.001);
    assert!(figures.joints.manipulability_min.unwrap() > 0.03);
}

#[test]
fn every_scenario_ends_as_it_should_and_without_losing_the_surface() {
    for (name, _) in SCENARIOS {
        let result = run(name, &[]);
        assert_eq!((result.phase, result.fault), ("done", None), "{name}");
        assert_eq!(result.figures.contact.lost_count, 0, "{name}");
        assert!(
            result.figures.normal_error_deg.unwrap().mean < 5.0,
            "{name}"
        );
    }
}

#[test]
fn a_cone_with_realistic_sensing_is_followed() {
    let figures = run("cone_realistic", &[]).figures;
    let alignment = figures.alignment_error_deg.unwrap();
    assert!(
        alignment.mean <= 6.0 && alignment.rmse <= 9.0,
        "{alignment:?}"
    );
}

#[test]
fn touchdown_on_a_stiff_surface_overshoots_little() {
    let force = run("touchdown_10kN_per_m", &[]).figures.force;
    assert!(force.overshoot_percent.unwrap() <= 30.0, "{force:?}");
    assert!((force.mean_n.unwrap() - 3.0).abs() < 0.1, "{force:?}");
}

#[test]
fn equal_input_gives_equal_bits() {
    let short = "task.path.length_m=0.04";
    let digest = |overrides: &[&str]| run("cone_realistic", overrides).state_digest;
    let once = digest(&[short]);
    assert_eq!(once, digest(&[short]));
    assert_ne!(once, digest(&[short, "seed=2"]));
    assert_eq!(once.len(), 64);
}

#[test]
fn the_sensors_rate_does_not_change_the_figures() {
    let over_seeds = |rate: &str| {
        let (mut normal, mut force) = (0.0, 0.0);
        for seed in ["seed=1", "seed=2", "seed=3"] {
            let figures = run("pipe_realistic", &[rate, seed, "task.path.step_m=0.05"]).figures;
            normal += figures.normal_error_deg.unwrap().rmse / 3.0;
            force += figures.force.rmse_n.unwrap() / 3.0;
        }
        (normal, force)
    };
    let slow = over_seeds("plant.sensor.rate_hz=1000");
    let fast = over_seeds("plant.sensor.rate_hz=7000");
    assert!((slow.0 / fast.0 - 1.0).abs() < 0.2, "{slow:?} {fast:?}");
    assert!((slow.1 / fast.1 - 1.0).abs() < 0.2, "{slow:?} {fast:?}");
}

#[test]
fn an_override_reaches_the_plant_the_law_and_the_task() {
    let scenario = parse(
        "pipe_ideal",
        &[
            "plant.contact.stiffness_n_per_m=8000",
            "control.alignment.gain_per_s=1.5",
            "task.estimators=[\"reactive\"]",
            "controller=paper",
            "seed=9",
        ],
    )
    .unwrap();
    assert_eq!(scenario.plant.contact.stiffness_n_per_m, 8000.0);
    let config = scenario.controller_config().unwrap();
    assert_eq!(config.alignment.gain_per_s, 1.5);
    assert_eq!(config.force.damping_n_s_per_m, 150.0);
    assert_eq!((scenario.seed, scenario.task.estimators.len()), (9, 1));
}

#[test]
fn a_bad_override_is_refused_with_what_is_allowed() {
    for (text, parts) in [
        (
            "plant.contact.stifness=1",
            &["stifness", "stiffness_n_per_m"][..],
        ),
        ("plant.surface.radius=1", &["radius"]),
        ("plant.surface.shape=cube", &["cube", "cylinder"]),
        ("plant.contact.friction.model=sticky", &["sticky", "lugre"]),
        ("seed=-1", &["seed=-1"]),
        ("duration_s=long", &["duration_s=long", "long"]),
        ("duration_s=0", &["duration_s", "0.1 to 86400"]),
        (
            "pipeline.exchange_cycles=99",
            &["exchange_cycles", "0 to 16"],
        ),
        ("controller=magic", &["magic"]),
        ("control.alignment.gain=1", &["gain"]),
        ("plant.start.near_m.7=1", &["near_m", "0 to 2"]),
        ("task.force=3", &["task.force=3"]),
    ] {
        let message = refused("pipe_ideal", &[text]);
        for part in parts {
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}

#[test]
fn what_only_building_shows_is_refused_too() {
    let error = |text: &str| {
        let scenario = parse("pipe_ideal", &[text]).unwrap();
        evaluate_admittance(&scenario).unwrap_err().to_string()
    };
    assert!(error("task.estimators=[\"guess\"]").contains("guess"));
    assert!(error("plant.robot=ur7").contains("ur7"));
    assert!(error("plant.surface.radius_m=-1").contains("radius_m"));
    assert!(error("plant.start.near_m=[9.0, 0.0, 0.0]").contains("start"));
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let message = refused("height_field", &["plant.surface.csv_file=lost.csv"]);
    assert!(
        message.contains("lost.csv") && message.contains("not there"),
        "{message}"
    );
}

#[test]
fn a_bad_file_is_refused_with_its_line() {
    let (_, text) = SCENARIOS[0];
    let error = |text: &str| {
        AdmittanceScenario::parse("x.toml", text, &[], &read)
            .unwrap_err()
            .to_string()
    };
    let typed = error(&text.replace("seed = 1", "seed = \"one\""));
    assert!(
        typed.contains("x.toml") && typed.contains("line"),
        "{typed}"
    );
    let missing = error(&text.replace("duration_s = 60.0", ""));
    assert!(missing.contains("duration_s"), "{missing}");
    assert!(error("[[[").contains("x.toml"));
}

/// A velocity-controlled arm can have a tank for the energy that it puts into the surface.
#[test]
fn a_force_tank_that_lasts_changes_nothing_and_one_that_does_not_stops_the_pushing() {
    let tank = |initial_j: f64| {
        [
            format!("control.force.tank.initial_j={initial_j}"),
            "control.force.tank.lower_j=0.001".to_owned(),
            "control.force.tank.upper_j=2.0".to_owned(),
            "control.force.tank.band_j=0.002".to_owned(),
            "control.force.tank.reserve_j=0.0001".to_owned(),
        ]
    };
    let with = |initial_j: f64| {
        let set = tank(initial_j);
        let set: Vec<&str> = set.iter().map(String::as_str).collect();
        run("pipe_realistic", &set)
    };
    let (plain, full) = (run("pipe_realistic", &[]), with(1.0));
    assert!(plain.figures.tanks.is_none());
    assert_eq!((full.phase, full.fault), ("done", None));
    assert_eq!(full.state_digest, plain.state_digest);
    let tanks = full.figures.tanks.unwrap();
    assert!(
        tanks.force_min_j < 1.0 && tanks.force_min_j > 0.99,
        "{tanks:?}"
    );
    // The soft pad alone takes more energy than this.
    let empty = with(0.002);
    let tanks = empty.figures.tanks.unwrap();
    assert!(tanks.force_min_j >= 0.001, "{tanks:?}");
    let (less, asked) = (empty.figures.force.mean_n, plain.figures.force.mean_n);
    assert!(
        less.is_none_or(|n| n < 0.8 * asked.unwrap()),
        "{less:?} of {asked:?}"
    );
}
