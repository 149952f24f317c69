//! The published wave, with single keys changed.

use tangent_simulation::TactileScenario;

const WAVE: &str = include_str!("../../../../scenarios/karacan/karacan_wave.toml");

pub fn scenario(set: &[&str]) -> TactileScenario {
    let set: Vec<String> = set.iter().map(|s| (*s).to_owned()).collect();
    TactileScenario::parse("karacan_wave", WAVE, &set).unwrap()
}
