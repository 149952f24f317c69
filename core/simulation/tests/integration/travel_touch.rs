//! A tool that touches something on its way to the start of a task: it stops, and gives way.

// The test prints its results, and reads a scenario of the repository.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
// A whole file of tests: what fails here is the test.
use nalgebra::Vector6;
use tangent_control::{Clearance, Fault, Phase};
use tangent_simulation::{AdmittanceLoop, AdmittanceScenario, Obstacle, no_files};

/// Largest force with which the tool may rest at what it met, N.
const RESTS_MAX_N: f64 = 4.0;
/// Joint speed of the way, rad/s.
const SPEED_RAD_PER_S: f64 = 0.1;

fn cell(set: &[String]) -> AdmittanceLoop {
    let file = format!("{}/../../scenarios/plane.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(file).unwrap();
    let scenario = AdmittanceScenario::parse("plane", &text, set, &no_files).unwrap();
    AdmittanceLoop::new(&scenario).unwrap()
}

/// Meets a wall 3 mm above the tool; returns the largest true force, and the one with which the
/// tool rests, N.
fn meets_a_wall(stiffness_n_per_m: f64) -> (f64, f64) {
    let mut q = Vector6::zeros();
    let _ = cell(&[]).step(&mut |c| q = c.input.q);
    // Up, away from the surface.
    q[1] -= 0.3;
    let set = [
        format!(
            "task.start={{joints_rad={:?},speed_rad_per_s={SPEED_RAD_PER_S}}}",
            q.as_slice()
        ),
        "plant.sensor.noise_n_per_sqrt_hz=0.002".to_owned(),
    ];
    let mut cell = cell(&set);
    cell.put_in_the_way(Obstacle {
        gap_m: 0.003,
        stiffness_n_per_m,
    });
    let (mut peak_n, mut rests_n, mut ended_s) = (0.0_f64, 0.0, 0.0);
    let period_s = cell.plant().period_s();
    for _ in 0..(10.0 / period_s) as usize {
        let _ = cell.step(&mut |c| {
            let force_n = c.truth.wrench.force.norm();
            peak_n = peak_n.max(force_n);
            rests_n = force_n;
            if c.output.phase == Phase::Fault {
                ended_s += period_s;
                assert_eq!(c.output.fault, Some(Fault::TravelTouched));
                assert_eq!(c.output.clearance, Clearance::Unknown);
            }
        });
    }
    assert!(ended_s > 0.5, "{stiffness_n_per_m}: still on its way");
    (peak_n, rests_n)
}

#[test]
fn a_tool_that_touches_something_on_its_way_to_the_start_gives_way() {
    let mut wrong = Vec::new();
    for stiffness in [5e3, 2.5e4, 1e5] {
        let (peak_n, rests_n) = meets_a_wall(stiffness);
        println!("{stiffness} N/m: {peak_n:.1} N, rests with {rests_n:.1} N");
        if rests_n > RESTS_MAX_N {
            wrong.push((stiffness, peak_n, rests_n));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}
