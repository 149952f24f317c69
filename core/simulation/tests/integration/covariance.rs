//! Tests that the estimators' covariances agree with the true errors, over scenarios, seeds,
//! frictions, stiffnesses and noises.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used, clippy::disallowed_methods)]

use crate::nees::{ESTIMATORS, Phases, measure};
use tangent_simulation::{AdmittanceScenario, FileError};

const SLIDE: usize = 1;
const SEEDS: u64 = 5;
const IDEAL: [&str; 7] = [
    "cone_ideal",
    "height_field",
    "pipe_ideal",
    "plane",
    "sheet",
    "sphere",
    "torus",
];
const REALISTIC: [&str; 2] = ["cone_realistic", "pipe_realistic"];

fn over_seeds(name: &str, seeds: u64, overrides: &[&str]) -> [Phases; 4] {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios/");
    let read =
        |file: &str| std::fs::read_to_string(format!("{folder}{file}")).map_err(FileError::new);
    let text = read(&format!("{name}.toml")).unwrap();
    let mut sums = [Phases::default(); 4];
    for seed in 1..=seeds {
        let mut all: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
        all.push(format!("seed={seed}"));
        all.push(format!("task.estimators={ESTIMATORS:?}"));
        let scenario = AdmittanceScenario::parse(name, &text, &all, &read).unwrap();
        for (sum, part) in sums.iter_mut().zip(&measure(&scenario).unwrap()) {
            sum.merge(part);
        }
    }
    sums
}

/// The variance is never too small by more than a factor of two, and small enough to be useful.
/// Where bias, friction or the surface's shape cause the error, the error has the size stated.
#[test]
fn what_is_claimed_is_true_and_of_use() {
    // Ideal sensing draws nothing from the seed.
    for (names, seeds, claim_max_deg) in [(&IDEAL[..], 1, 1.0), (&REALISTIC[..], SEEDS, 2.4)] {
        for name in names {
            let least = match *name {
                "sheet" => 0.1,
                "cone_realistic" => 0.05,
                "pipe_realistic" => 0.02,
                // With perfect sensors on a perfect surface, the error is almost zero, but the
                // covariance never is.
                _ => 0.0,
            };
            for (estimator, phases) in ESTIMATORS.iter().zip(&over_seeds(name, seeds, &[])) {
                let text = format!("{name} {estimator}: {}", phases.all().text());
                // The window of the exploration's circle is smaller than that of a stroke.
                let most = if estimator.starts_with("quadratic") {
                    2.3
                } else {
                    2.0
                };
                assert!((least..most).contains(&phases.all().nees()), "{text}");
                let claim = phases.0[SLIDE].claim_deg();
                assert!(claim < claim_max_deg, "{text}, sliding {claim} deg");
            }
        }
    }
}

/// Other friction, stiffness, noise and load than in any scenario.
#[test]
fn the_claim_holds_in_other_cells() {
    let friction = |mu: f64| {
        [
            format!("plant.contact.friction.coulomb_coefficient={mu}"),
            format!("plant.contact.friction.static_coefficient={}", 1.2 * mu),
        ]
    };
    let everywhere = [
        "pipe_ideal",
        "sheet",
        "sphere",
        "pipe_realistic",
        "cone_realistic",
    ];
    let set = |one: &str| vec![one.to_owned()];
    for (names, cell) in [
        (&everywhere[..], friction(0.1).to_vec()),
        (&everywhere[..], friction(0.6).to_vec()),
        (&everywhere[..], set("plant.contact.stiffness_n_per_m=1000")),
        (
            &everywhere[..],
            set("plant.contact.stiffness_n_per_m=14000"),
        ),
        (&everywhere[..], set("plant.start.tilt_rad=0.1")),
        (&everywhere[..], set("task.force.reference_n=8.0")),
        // A sensor stated to be perfect is trusted: noise is added only where the settings allow
        // for it.
        (
            &REALISTIC[..],
            set("plant.sensor.noise_n_per_sqrt_hz=0.004"),
        ),
        (&REALISTIC[..], set("plant.sensor.drift_n=0.0")),
    ] {
        let overrides: Vec<&str> = cell.iter().map(String::as_str).collect();
        let mut mean = 0.0;
        for name in names {
            let blend = over_seeds(name, 1, &overrides)[0].all();
            assert!(blend.nees() < 4.0, "{name} {cell:?}: {}", blend.text());
            mean += blend.nees() / names.len() as f64;
        }
        assert!((0.03..2.0).contains(&mean), "{cell:?}: {mean}");
    }
}
