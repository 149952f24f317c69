//! The published wave scenario, with single keys changed.

use tangent_simulation::VisuoTactileScenario;

const WAVE: &str = include_str!("../../../../../scenarios/karacan/karacan_wave.toml");

pub fn scenario(set: &[&str]) -> VisuoTactileScenario {
    let set: Vec<String> = set.iter().map(|s| (*s).to_owned()).collect();
    VisuoTactileScenario::parse("karacan_wave", WAVE, &set).unwrap()
}
