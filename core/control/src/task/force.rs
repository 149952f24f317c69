//! `[force]` of a task file.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};
use crate::task::path::{FORCE_N, check_force_profile};

/// Pressing force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSpec {
    /// Pressing force along the normal, N, positive.
    pub reference_n: f64,
    /// Force along the whole path instead: `[way in m, force in N]` each, linear between them,
    /// constant beyond. Ways above the surface do not count.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub profile: Vec<[f64; 2]>,
}

impl ForceSpec {
    /// One pressing force on the whole path, N.
    pub fn constant(reference_n: f64) -> Self {
        Self {
            reference_n,
            profile: Vec::new(),
        }
    }

    /// Checks that every number is in its range.
    pub(super) fn check(&self) -> Result<(), ControlError> {
        let (least_n, most_n) = FORCE_N;
        check_range("force.reference_n", self.reference_n, least_n, most_n)?;
        if !self.profile.is_empty() {
            check_force_profile("force.profile", &self.profile)?;
        }
        Ok(())
    }
}
