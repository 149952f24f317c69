//! `[zero]` of a task file.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// Limit on the age of the sensor's zero during a task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZeroSpec {
    /// Maximum error implied by the zero's age and the sensor's stated drift, N; `None`: no limit.
    pub error_max_n: Option<f64>,
    /// Reaction when the limit is exceeded.
    pub at_limit: ZeroAtLimit,
}

impl ZeroSpec {
    /// Checks that every number is in its range.
    pub(super) fn check(&self) -> Result<(), ControlError> {
        if let Some(error_n) = self.error_max_n {
            check_range("zero.error_max_n", error_n, 0.005, 100.0)?;
        }
        Ok(())
    }
}

/// Reaction to a zero that is too old.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ZeroAtLimit {
    /// The task ends with a retraction.
    #[default]
    Stop,
    /// The tool lifts off, the sensor is tared, and the task continues where it was. For
    /// velocity-controlled arms on a base that stands; others stop.
    Retare,
}
