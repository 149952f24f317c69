//! The `[plant.contact]` table: normal force and friction.

use serde::{Deserialize, Serialize};

use super::friction::FrictionConfig;
use crate::plant_error::PlantError;

/// Normal force and friction between pad and surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactConfig {
    /// Stiffness along the normal with the pad flat on the surface, as seen from the flange: pad
    /// and tool compliance in series, N/m.
    pub stiffness_n_per_m: f64,
    /// Hunt-Crossley exponent; 1 for a layer that is thin compared to the pad. With another
    /// exponent, `stiffness_n_per_m` holds at a depth of 1 mm.
    pub exponent: f64,
    /// Hunt-Crossley damping factor, s/m: `F = k x^e (1 + 1.5 a x')`.
    pub dissipation_s_per_m: f64,
    /// Friction law.
    pub friction: FrictionConfig,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            stiffness_n_per_m: 5_000.0,
            exponent: 1.0,
            dissipation_s_per_m: 4.0,
            friction: FrictionConfig::default(),
        }
    }
}

impl ContactConfig {
    /// Checks that the stiffness is in its range.
    ///
    /// # Errors
    /// The stiffness is out of its range; the error states the range.
    pub(crate) fn check_stiffness(&self) -> Result<(), PlantError> {
        PlantError::unless(
            "contact.stiffness_n_per_m",
            self.stiffness_n_per_m,
            "100 to 1000000 N/m",
            (100.0..=1e6).contains(&self.stiffness_n_per_m),
        )
    }
}
