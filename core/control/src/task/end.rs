//! `[end]` of a task file, and `[timeouts]`, after which a task ends early.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// End of the task.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EndSpec {
    /// Time for which the force is held at the end of the path, s.
    pub hold_s: f64,
    /// Distance of the retraction along the normal, m.
    pub retract_distance_m: f64,
    /// Speed of the retraction, m/s.
    pub retract_speed_m_per_s: f64,
}

impl Default for EndSpec {
    fn default() -> Self {
        Self {
            hold_s: 0.5,
            retract_distance_m: 0.05,
            retract_speed_m_per_s: 0.02,
        }
    }
}

impl EndSpec {
    /// Checks that every number is in its range.
    pub(super) fn check(&self) -> Result<(), ControlError> {
        check_range("end.hold_s", self.hold_s, 0.0, 600.0)?;
        check_range(
            "end.retract_distance_m",
            self.retract_distance_m,
            0.005,
            0.5,
        )?;
        check_range(
            "end.retract_speed_m_per_s",
            self.retract_speed_m_per_s,
            0.001,
            0.1,
        )
    }
}

/// Timeouts of a task, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TimeoutSpec {
    /// Timeout of the tare before contact, s.
    pub tare_s: f64,
    /// Timeout for the force to settle after touchdown, s.
    pub contact_s: f64,
    /// Timeout of the whole task, s; 0: no limit.
    pub task_s: f64,
}

impl Default for TimeoutSpec {
    fn default() -> Self {
        Self {
            tare_s: 5.0,
            contact_s: 10.0,
            task_s: 0.0,
        }
    }
}

impl TimeoutSpec {
    /// Checks that every number is in its range.
    pub(super) fn check(&self) -> Result<(), ControlError> {
        check_range("timeouts.tare_s", self.tare_s, 0.1, 120.0)?;
        check_range("timeouts.contact_s", self.contact_s, 0.5, 120.0)?;
        check_range("timeouts.task_s", self.task_s, 0.0, 86_400.0)
    }
}
