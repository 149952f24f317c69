//! `[switching]` of a task file.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// Rules for switches between estimators.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SwitchingSpec {
    /// Maximum angle between a candidate's normal and the one in use, rad; `None`: the law's
    /// `normal.switch_gate_rad`.
    pub disagreement_max_rad: Option<f64>,
    /// Time for which the preferred estimator must be usable before it is chosen again after a
    /// fallback, s; `None`: only on request.
    pub return_after_good_s: Option<f64>,
}

impl SwitchingSpec {
    /// Checks that every number is in its range.
    pub(super) fn check(&self) -> Result<(), ControlError> {
        if let Some(angle) = self.disagreement_max_rad {
            check_range("switching.disagreement_max_rad", angle, 0.01, 3.0)?;
        }
        if let Some(time) = self.return_after_good_s {
            check_range("switching.return_after_good_s", time, 0.05, 3600.0)?;
        }
        Ok(())
    }
}
