//! `[cell]`: name and state folder of the cell.

use std::path::PathBuf;

use serde::Deserialize;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[cell]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellSection {
    /// Namespace of all keys on the network.
    pub name: String,
    /// Folder for data that services keep across restarts and power cuts: the permission for the
    /// tool to touch, and the sensor's last good zero. Default: the folder that systemd gives the
    /// service (`$STATE_DIRECTORY`), else `state` beside the cell file; each cell has a subfolder
    /// of its name.
    #[serde(default)]
    pub state_folder: Option<PathBuf>,
}

/// Whether the text is valid as a cell's name in every key on the network.
pub(super) fn is_cell_name(name: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    (1..=32).contains(&name.len()) && name.chars().all(good)
}

impl CellSection {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.require(
            is_cell_name(&self.name),
            "cell.name",
            &self.name,
            "1 to 32 letters, digits, `_` or `-`",
        )
    }
}
