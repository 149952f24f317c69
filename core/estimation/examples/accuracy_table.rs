//! Prints the accuracy of every estimator on contacts in closed form:
//! `cargo run --release -p tangent-estimation --example accuracy_table`.
#![allow(clippy::unwrap_used, clippy::disallowed_macros)]

#[path = "../tests/integration/synthetic/mod.rs"]
mod synthetic;

use synthetic::{Figures, Flaws, Surface, Trial};
use tangent_estimation::{EstimatorConfig, SensingConfig, build, estimator_names};

fn main() {
    let ideal = EstimatorConfig {
        sensing: SensingConfig::ideal(),
        ..Default::default()
    };
    println!("| sensing | surface | estimator | mean deg | RMSE deg | max deg | NEES per dof |");
    println!("|---|---|---|---|---|---|---|");
    for (title, flaws, config) in [
        ("ideal", Flaws::NONE, ideal),
        ("Gamma", Flaws::GAMMA, EstimatorConfig::default()),
    ] {
        for (shape, surface) in [
            ("plane", Surface::Plane),
            ("pipe", Surface::Cylinder(0.25)),
            ("cone", Surface::Cone(0.19, 0.5)),
        ] {
            for name in estimator_names() {
                let mut all = Figures::default();
                for seed in 0..12 {
                    let mut estimator = build(name, &config).unwrap();
                    all.merge(Trial::new(surface, flaws, seed).run(estimator.as_mut()));
                }
                println!(
                    "| {title} | {shape} | `{name}` | {:.2} | {:.2} | {:.1} | {:.2} |",
                    all.mean_deg(),
                    all.rmse_deg(),
                    all.max_deg(),
                    all.nees_per_dof()
                );
            }
        }
    }
}
