//! Iterative learning over repeated passes: what `docs/controllers/learning.md` states.

use tangent_control::{LearningSpec, Memory, Task};
use tangent_simulation::{
    AdmittanceScenario, FileError, PassEvaluation, evaluate_admittance, evaluate_admittance_pass,
    evaluate_admittance_passes,
};

fn scenario(name: &str, overrides: &[&str]) -> AdmittanceScenario {
    let file = format!("{}/../../scenarios/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&file).unwrap();
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let none = |_: &str| Err(FileError::new("no file"));
    AdmittanceScenario::parse(&file, &text, &overrides, &none).unwrap()
}

fn rmse_n(pass: &PassEvaluation) -> f64 {
    assert_eq!(pass.evaluation.phase, "done", "{:?}", pass.evaluation.fault);
    pass.evaluation.figures.force.rmse_n.unwrap()
}

/// Memory after `passes` of a scenario.
fn learnt(scenario: &AdmittanceScenario, passes: u32) -> Option<Memory> {
    let mut memory = None;
    for pass in 1..=passes {
        memory = evaluate_admittance_pass(scenario, pass, memory).unwrap().1;
    }
    memory
}

#[test]
fn five_passes_halve_the_force_error_on_a_sheet() {
    let passes = evaluate_admittance_passes(&scenario("sheet", &[]), 5).unwrap();
    let errors: Vec<f64> = passes.iter().map(rmse_n).collect();
    assert!(errors[4] <= 0.5 * errors[0], "{errors:?}");
    assert!(errors[1] < 0.8 * errors[0], "{errors:?}");
}

/// Most of the true error on this cone is the sensor's drift and the error of the payload, which no
/// measured force can show. The error that the sensor shows is halved.
#[test]
fn five_passes_halve_the_measured_force_error_on_a_realistic_cone() {
    let passes = evaluate_admittance_passes(&scenario("cone_realistic", &[]), 5).unwrap();
    let measured: Vec<f64> = passes
        .iter()
        .map(|pass| pass.force_measured_rmse_n.unwrap())
        .collect();
    assert!(measured[4] <= 0.5 * measured[0], "{measured:?}");
    assert!(measured[4] <= 0.027, "{measured:?}");
}

/// The tool keeps to the mean of the normals of the passes before, which err in other directions.
#[test]
fn after_some_passes_the_tool_is_squarer_than_its_estimates() {
    let scenario = scenario("cone_realistic", &[]);
    let mean = |pass: &PassEvaluation| {
        let figures = &pass.evaluation.figures;
        [&figures.normal_error_deg, &figures.tool_error_deg].map(|s| s.unwrap().mean)
    };
    let memory = learnt(&scenario, 4);
    let without = mean(&evaluate_admittance_pass(&scenario, 5, None).unwrap().0);
    let with = mean(&evaluate_admittance_pass(&scenario, 5, memory).unwrap().0);
    assert!(with[1] <= 0.6 * without[1], "{with:?} {without:?}");
    assert!(with[1] <= 0.75 * with[0], "{with:?}");
}

/// The true error on that cone falls with the measured one where the sensor does not drift and the
/// payload is known; the rest is the exploration before the path.
#[test]
fn without_errors_of_the_zero_the_true_force_error_falls_on_the_cone() {
    let exact = [
        "plant.sensor.drift_n=0.0",
        "plant.sensor.drift_nm=0.0",
        "plant.sensor.walk_n_per_sqrt_s=0.0",
        "plant.tool.payload_error.mass_kg=0.0",
        "plant.tool.payload_error.com_in_sensor_m=[0.0, 0.0, 0.0]",
    ];
    let passes = evaluate_admittance_passes(&scenario("cone_realistic", &exact), 5).unwrap();
    let errors: Vec<f64> = passes.iter().map(rmse_n).collect();
    assert!(errors[4] <= 0.75 * errors[0], "{errors:?}");
}

#[test]
fn the_first_pass_and_a_task_that_does_not_learn_are_the_same() {
    let scenario = scenario("sheet", &[]);
    let alone = evaluate_admittance(&scenario).unwrap();
    let (first, memory) = evaluate_admittance_pass(&scenario, 1, None).unwrap();
    assert_eq!(alone.state_digest, first.evaluation.state_digest);
    assert_eq!(memory.unwrap().passes(), 1);
    // One object per pass, with the keys of `evaluate --json` beside its own.
    let json = serde_json::to_value(&first).unwrap();
    assert_eq!(
        json["force"]["rmse_n"],
        first.evaluation.figures.force.rmse_n.unwrap()
    );
    assert_eq!((&json["pass"], &json["phase"]), (&1.into(), &"done".into()));
}

/// The touchdown is 1 to 2 mm off in each pass, along and across the path.
#[test]
fn a_touchdown_elsewhere_is_tolerated() {
    let shifts_m = [
        [0.0, 0.0],
        [0.0015, -0.001],
        [-0.001, 0.002],
        [0.002, 0.001],
        [-0.002, -0.0015],
    ];
    let mut memory = None;
    let mut errors = Vec::new();
    for (pass, [x, y]) in (1..).zip(shifts_m) {
        let near = format!("plant.start.near_m=[{}, {}, 0.1]", 0.36 + x, -0.04 + y);
        let scenario = scenario("sheet", &[&near]);
        let (result, next) = evaluate_admittance_pass(&scenario, pass, memory).unwrap();
        errors.push(rmse_n(&result));
        memory = next;
    }
    // The passes differ in their touchdown, so the force law's own error of 0.02 N remains.
    assert!(errors[4] <= 0.6 * errors[0], "{errors:?}");
}

/// A part that was exchanged costs no more than a fifth of the error without a memory and 5 mN,
/// and is learnt itself.
#[test]
fn an_exchanged_part_is_noticed_and_learnt() {
    let memory = learnt(&scenario("sheet", &[]), 4);
    for other in [
        "plant.surface.amplitude_m=[-0.004, -0.003]",
        "plant.surface.wavelength_m=[0.09, 0.11]",
        "plant.surface.amplitude_m=[0.0, 0.0]",
        "plant.surface.position_m=[0.43, 0.02, 0.1]",
    ] {
        let exchanged = scenario("sheet", &[other]);
        let mut memory = memory.clone();
        // The sensing of this scenario is ideal: the error without a memory is that of any seed.
        let without = rmse_n(&evaluate_admittance_pass(&exchanged, 5, None).unwrap().0);
        let mut errors = Vec::new();
        for pass in 5..=9 {
            let (with, next) = evaluate_admittance_pass(&exchanged, pass, memory).unwrap();
            errors.push(rmse_n(&with));
            memory = next;
        }
        let words = format!("{other}: {without} without, {errors:?} with the memory");
        println!("{words}");
        assert!(
            errors.iter().all(|with| *with <= 1.5 * without + 0.005),
            "{words}"
        );
        assert!(errors[4] <= 0.75 * without + 0.005, "{words}");
    }
}

/// A memory survives being stored, and one of another path is refused.
#[test]
fn a_memory_is_stored_and_read_again() {
    let sheet = scenario("sheet", &[]);
    let memory = learnt(&sheet, 2).unwrap();
    let read = toml::from_str::<Memory>(&toml::to_string(&memory).unwrap()).unwrap();
    let (a, _) = evaluate_admittance_pass(&sheet, 3, Some(memory)).unwrap();
    let (b, _) = evaluate_admittance_pass(&sheet, 3, Some(read.clone())).unwrap();
    assert_eq!(a.evaluation.state_digest, b.evaluation.state_digest);
    let longer = scenario("sheet", &["task.path.length_m=0.12"]);
    let error = evaluate_admittance_pass(&longer, 3, Some(read)).unwrap_err();
    assert!(error.to_string().contains("another path"), "{error}");
}

/// A pass that ends with a fault, or is stopped, teaches nothing.
#[test]
fn an_interrupted_pass_teaches_nothing() {
    let mut short = scenario("sheet", &["task.timeouts.task_s=12.0"]);
    short.task.learning = Some(LearningSpec::of("part"));
    let (result, memory) = evaluate_admittance_pass(&short, 1, None).unwrap();
    assert_eq!(result.evaluation.phase, "fault");
    assert_eq!(memory.unwrap().passes(), 0);
}

#[test]
fn the_keys_of_learning_are_checked() {
    let text =
        "name = \"a\"\nforce.reference_n = 3.0\npath = { kind = \"stay\", duration_s = 1.0 }\n";
    for (line, wrong) in [
        ("part = \"a b\"", "learning.part"),
        ("part = \"\"", "learning.part"),
        ("part = \"a\"\nslope_max = 0.9", "learning.slope_max"),
        (
            "part = \"a\"\nchange_max_rad = 0.0",
            "learning.change_max_rad",
        ),
        ("part = \"a\"\nfoo = 1", "foo"),
        ("slope_max = 0.1", "part"),
    ] {
        let error = format!("{text}[learning]\n{line}\n")
            .parse::<Task>()
            .unwrap_err()
            .to_string();
        assert!(error.contains(wrong), "{wrong}: {error}");
    }
    assert!(
        format!("{text}learning.part = \"a-1\"")
            .parse::<Task>()
            .is_ok()
    );
}
