//! A small cell file for the tests of its sections.

use super::CellConfig;

/// A cell file with the required keys and `more`.
pub fn cell(more: &str) -> Result<CellConfig, String> {
    let text = format!(
        "[cell]\nname = \"cell1\"\n[robot]\nmodel = \"ur5\"\naddress = \"127.0.0.1\"\n[sensor]\naddress = \"127.0.0.1\"\n\
         [tool]\nmass_kg = 0.3\ncom_in_sensor_m = [0.0, 0.0, 0.05]\nflange_from_tool = {{ translation_m = [0.0, 0.0, 0.15] }}\n{more}"
    );
    CellConfig::parse("cell.toml", &text).map_err(|error| error.to_string())
}
