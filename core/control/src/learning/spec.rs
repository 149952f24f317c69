//! `[learning]` of a task.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// Learning over repeated passes of one task over one part.
///
/// ```
/// let task: tangent_control::Task = r#"
///     name = "wipe"
///     force.reference_n = 3.0
///     learning.part = "bonnet-left"
///     [path]
///     kind = "line"
///     to_m = [0.1, 0.0]
///     speed_m_per_s = 0.02
/// "#
/// .parse()
/// .unwrap();
/// assert_eq!(task.learning.unwrap().slope_max, 0.3);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearningSpec {
    /// Name of the part. Passes over the same part share a memory.
    pub part: String,
    /// Bound of the fed-forward slope between the surface learnt and the tangent plane in use,
    /// metres along the normal per metre along the path.
    #[serde(default = "slope_max")]
    pub slope_max: f64,
    /// Bound on the change of the learnt direction of the surface in one pass, rad.
    #[serde(default = "change_max_rad")]
    pub change_max_rad: f64,
}

fn slope_max() -> f64 {
    0.3
}

fn change_max_rad() -> f64 {
    0.05
}

impl LearningSpec {
    /// Learning for `part` with the default bounds.
    pub fn of(part: &str) -> Self {
        Self {
            part: part.to_owned(),
            slope_max: slope_max(),
            change_max_rad: change_max_rad(),
        }
    }

    pub(crate) fn check(&self) -> Result<(), ControlError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        let length = self.part.len();
        if length == 0 || length > 64 || !self.part.chars().all(plain) {
            return Err(ControlError::range(
                "learning.part",
                format!("\"{}\"", self.part),
                "1 to 64 letters, digits, `_` and `-`",
            ));
        }
        check_range("learning.slope_max", self.slope_max, 0.01, 0.5)?;
        check_range("learning.change_max_rad", self.change_max_rad, 0.001, 0.5)
    }
}
