//! Errors that hardware has and nobody is told: the difference between what the plant does and what
//! the cell file states.
//!
//! A scenario's plant without its `[plant.errors]` table is what the law, the estimators and the
//! conditioning are told. Only the plants read the table: [`HardwareErrors`] that of
//! [`AdmittancePlant`](crate::AdmittancePlant), [`TorqueErrors`] those of
//! [`ObjectPlant`](crate::ObjectPlant) and [`VisuoTactilePlant`](crate::VisuoTactilePlant).

pub mod arm_errors;
pub mod frame_errors;
pub mod torque_errors;
pub mod wrench_errors;

use serde::{Deserialize, Serialize};

pub use arm_errors::{ArmErrors, ArmSenses};
pub use frame_errors::FrameErrors;
pub use torque_errors::{ErrorRanges, TorqueArmErrors, TorqueErrors, WrenchEstimateErrors};
pub use wrench_errors::{WrenchDistortion, WrenchErrors};

use crate::contact::FrictionVariation;
use crate::plant_error::PlantError;

/// The `[plant.errors]` table. Everything in it is off by default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HardwareErrors {
    /// Frames of tool and sensor.
    pub frames: FrameErrors,
    /// Servo, encoders and measured joint velocities.
    pub arm: ArmErrors,
    /// Readings of the force/torque sensor.
    pub wrench: WrenchErrors,
    /// Friction that varies along the surface; constant if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction: Option<FrictionVariation>,
}

impl HardwareErrors {
    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// The first number out of its range.
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        self.frames.check()?;
        self.arm.check()?;
        self.wrench.check()?;
        if let Some(friction) = &self.friction {
            friction.check()?;
        }
        Ok(())
    }
}
