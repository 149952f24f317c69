//! `[cell]`: which cell this is.

use serde::Deserialize;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[cell]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellSection {
    /// Namespace of all keys on the network.
    pub name: String,
}

impl CellSection {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        let fits = (1..=32).contains(&self.name.len()) && self.name.chars().all(good);
        checker.require(
            fits,
            "cell.name",
            &self.name,
            "1 to 32 letters, digits, `_` or `-`",
        )
    }
}
