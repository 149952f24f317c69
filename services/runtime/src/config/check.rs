//! Range checks with errors that give the location of the value and the allowed range.

use std::fmt::Display;
use std::ops::RangeInclusive;

use super::load::{ConfigError, locate};

/// Checks values of one file. Other crates use it for their own files too.
pub struct Checker<'a> {
    file: &'a str,
    text: &'a str,
}

impl<'a> Checker<'a> {
    /// Checker for `text`, the contents of `file`.
    pub fn new(file: &'a str, text: &'a str) -> Self {
        Self { file, text }
    }

    /// Whether the file states this key.
    pub fn states(&self, key: &str) -> bool {
        locate(self.text, key).is_some()
    }

    /// Line of the innermost table of a key that the file does not state; 0 without one.
    fn line_of_table(&self, key: &str) -> usize {
        let mut table = key;
        while let Some((outer, _)) = table.rsplit_once('.') {
            if let Some((line, _)) = locate(self.text, outer) {
                return line;
            }
            table = outer;
        }
        0
    }

    /// The error for one value. `allowed` completes "is not allowed: ".
    pub fn refuse(
        &self,
        key: &str,
        value: impl Display,
        allowed: impl Into<String>,
    ) -> ConfigError {
        let (line, shown) =
            locate(self.text, key).unwrap_or_else(|| (self.line_of_table(key), value.to_string()));
        ConfigError::Value {
            file: self.file.to_owned(),
            line,
            key: key.to_owned(),
            value: shown,
            allowed: allowed.into(),
        }
    }

    /// Checks a condition on a value.
    ///
    /// # Errors
    /// The condition does not hold.
    pub fn require(
        &self,
        holds: bool,
        key: &str,
        value: impl Display,
        allowed: &str,
    ) -> Result<(), ConfigError> {
        if holds {
            Ok(())
        } else {
            Err(self.refuse(key, value, allowed))
        }
    }

    /// Checks that a number is within bounds; NaN never is.
    ///
    /// # Errors
    /// The number is outside.
    pub fn range(
        &self,
        key: &str,
        value: f64,
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Result<(), ConfigError> {
        let allowed = format!("from {} to {} {unit}", range.start(), range.end());
        self.require(range.contains(&value), key, value, allowed.trim_end())
    }

    /// Checks that every number of a list is within bounds.
    ///
    /// # Errors
    /// A number is outside; the error is about the first one.
    pub fn ranges(
        &self,
        key: &str,
        values: &[f64],
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Result<(), ConfigError> {
        match values.iter().find(|value| !range.contains(value)) {
            Some(bad) => Err(self.refuse(
                key,
                bad,
                format!("each from {} to {} {unit}", range.start(), range.end())
                    .trim_end()
                    .to_owned(),
            )),
            None => Ok(()),
        }
    }
}
