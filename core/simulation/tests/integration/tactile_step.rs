//! The step of `unified_force_impedance` does not allocate, for any input.

// A whole file of tests: what fails here is the test.
use tangent_simulation::VisuoTactileScenario;
use tangent_simulation::systems::visuo_tactile::reproduction::{replay, step_inputs};

const WAVE: &str = include_str!("../../../../scenarios/karacan/karacan_wave.toml");

#[test]
fn a_whole_task_without_an_allocation() {
    for preset in ["default", "paper"] {
        let set = [
            format!("controller=\"{preset}\""),
            "task.path.duration_s=2.0".to_owned(),
        ];
        let scenario = VisuoTactileScenario::parse("karacan_wave", WAVE, &set).unwrap();
        let mut inputs = step_inputs(&scenario).unwrap();
        // The wrench is not finite for a while, so that the retraction is tested too.
        let n = inputs.len();
        for input in &mut inputs[n / 2..n / 2 + 200] {
            input.wrench.force.x = f64::NAN;
        }
        let mut most = 0;
        replay(&scenario, &inputs, |step| {
            most = most.max(allocation_counter::measure(step).count_total);
        })
        .unwrap();
        assert_eq!(most, 0, "{preset}");
    }
}
