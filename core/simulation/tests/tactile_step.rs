//! The step of `unified_force_impedance` allocates nothing, whatever it sees.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

use tangent_simulation::TactileScenario;
use tangent_simulation::karacan::{replay, step_inputs};

const WAVE: &str = include_str!("../../../scenarios/karacan/karacan_wave.toml");

#[test]
fn a_whole_task_without_an_allocation() {
    for preset in ["default", "paper"] {
        let set = [
            format!("controller=\"{preset}\""),
            "task.path.duration_s=2.0".to_owned(),
        ];
        let scenario = TactileScenario::parse("karacan_wave", WAVE, &set).unwrap();
        let mut inputs = step_inputs(&scenario).unwrap();
        // A wrench that is no number for a while, so that the way off the surface is walked too.
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
