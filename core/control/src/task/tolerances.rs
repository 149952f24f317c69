//! What the result of a task must keep for the part to be accepted. The controller does not use it:
//! the report on a recording judges by it.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// Tolerances of a task's result; `None`: not judged.
///
/// ```
/// let task: tangent_control::Task = r#"
///     name = "wipe"
///     force.reference_n = 3.0
///     tolerances.force_rmse_n = 0.5
///     [path]
///     kind = "line"
///     to_m = [0.1, 0.0]
///     speed_m_per_s = 0.02
/// "#
/// .parse()
/// .unwrap();
/// assert_eq!(task.tolerances.force_rmse_n, Some(0.5));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Largest RMS error of the pressing force while the tool slides and holds, from 1 s after
    /// first contact, N.
    pub force_rmse_n: Option<f64>,
    /// Error of the pressing force that is exceeded in 5 % of that time, N.
    pub force_p95_n: Option<f64>,
    /// Highest pressing force of the whole task, N.
    pub force_peak_n: Option<f64>,
    /// Largest mean angle between the tool and the surface normal, rad: the true one in a simulated
    /// cell, else the estimated one.
    pub tool_angle_rad: Option<f64>,
    /// Largest RMS distance from the path, in the tangent plane, m.
    pub path_rmse_m: Option<f64>,
    /// Smallest share of the time between first contact and retraction with contact, 0 to 1.
    pub contact_share_min: Option<f64>,
}

impl Tolerances {
    /// Whether anything is judged.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn check(&self) -> Result<(), ControlError> {
        for (key, value, low, high) in [
            ("force_rmse_n", self.force_rmse_n, 0.001, 100.0),
            ("force_p95_n", self.force_p95_n, 0.001, 100.0),
            ("force_peak_n", self.force_peak_n, 0.1, 500.0),
            ("tool_angle_rad", self.tool_angle_rad, 0.001, 1.5),
            ("path_rmse_m", self.path_rmse_m, 1e-5, 0.1),
            ("contact_share_min", self.contact_share_min, 0.01, 1.0),
        ] {
            if let Some(value) = value {
                check_range(&format!("tolerances.{key}"), value, low, high)?;
            }
        }
        Ok(())
    }
}
