//! Changes of the estimator while the tool slides over a pipe must not affect the force.

// A whole file of tests: what fails here is the test.
use tangent_control::{Phase, SwitchCause};
use tangent_simulation::{AdmittanceLoop, AdmittanceScenario, no_files};

const PIPE: &str = include_str!("../../../../scenarios/pipe_ideal.toml");
/// Sliding time after which the touchdown is over, s.
const SETTLED_S: f64 = 2.0;
const SWITCH_EVERY_S: f64 = 0.7;

/// Slides on the pipe with repeated switches, and checks the true force and the normal in use.
#[test]
fn the_force_stays_within_ten_percent_through_every_swap() {
    let names = ["reactive", "quadratic", "gaussian_process", "blend"];
    let list = format!("task.estimators={names:?}");
    let scenario = AdmittanceScenario::parse("pipe_ideal", PIPE, &[list], &no_files);
    let scenario = scenario.unwrap();
    let reference_n = scenario.task.force.reference_n;
    let mut cell = AdmittanceLoop::new(&scenario).unwrap();
    let most_rad = cell.controller().config().normal.turn_rate_max_rad_per_s * 0.008 + 1e-9;
    let (mut sliding_since, mut asked_at, mut swaps, mut wanted) = (None, 0.0, 0, 0);
    let (mut used, mut normal, mut cause) = (0, None, SwitchCause::Task);
    let mut worst_n: f64 = 0.0;
    for _ in 0..8000 {
        let mut jump_rad: f64 = 0.0;
        let sample = cell.step(&mut |cycle| {
            used = cycle.output.estimator;
            cause = cycle.output.estimator_cause;
            let before = normal.replace(cycle.output.normal);
            if let (Some(before), Phase::Slide) = (before, cycle.output.phase) {
                jump_rad = cycle.output.normal.cross(&before).norm().asin();
            }
        });
        assert_eq!(used, wanted, "in the cycle after it was accepted");
        if sample.phase != Phase::Slide {
            if sliding_since.is_some() && sample.phase == Phase::Done {
                break;
            }
            continue;
        }
        assert!(jump_rad <= most_rad, "the normal turned by {jump_rad}");
        let since = *sliding_since.get_or_insert(sample.time_s);
        if sample.time_s - since < SETTLED_S {
            continue;
        }
        let force_n = sample.truth.unwrap().force_n;
        worst_n = worst_n.max((force_n - reference_n).abs());
        if sample.time_s - asked_at > SWITCH_EVERY_S {
            wanted = (used + 1) % names.len();
            cell.controller()
                .select_estimator(names[wanted], false)
                .unwrap();
            asked_at = sample.time_s;
            swaps += 1;
        }
    }
    assert_eq!(cause, SwitchCause::Asked);
    assert!(swaps > 20, "only {swaps} swaps");
    assert!(
        worst_n <= 0.1 * reference_n,
        "{worst_n} N off in {swaps} swaps"
    );
}
