//! Whether the tool may touch something: what is known when a task starts.
//!
//! A zero taken while the tool presses hides that force from every later reading. Each law
//! therefore keeps a [`Clearance`] across its tasks, and the service keeps it across restarts. If
//! contact is possible, a start first moves away from the surface
//! ([`Phase::Clear`](crate::phase_machine::Phase::Clear)), and `leave_watch` judges the force.

use nalgebra::Vector3;
use tangent_sensing::TareGround;

use crate::error::ControlError;
use crate::leaving::config::LeaveConfig;

/// Whether the tool may touch something.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Clearance {
    /// Assumed free: nothing was touched yet, or a person confirmed it. No motion has shown it.
    #[default]
    Assumed,
    /// A motion away from the surface has shown that the tool is free.
    Free,
    /// Contact is possible: a task left its start, and no retraction has ended in free space since.
    Possible {
        /// Direction away from the surface: unit, base axes.
        normal: Vector3<f64>,
        /// Last position of the tool's origin, base axes, m.
        position: Vector3<f64>,
    },
    /// Contact is possible, and the direction away from the surface is not known.
    Unknown,
}

impl Clearance {
    /// Whether the tool counts as free.
    pub fn is_free(&self) -> bool {
        matches!(self, Self::Assumed | Self::Free)
    }

    /// How far a zero that is taken now can be trusted.
    pub fn tare_ground(&self) -> TareGround {
        match self {
            Self::Free => TareGround::Shown,
            _ => TareGround::Assumed,
        }
    }

    /// Whether a task may start with the tool at `position` (base axes, m): `None` if the tool is
    /// free, else the direction in which it must first move away.
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] if contact is possible and the direction away is not known.
    pub fn way_out(
        &self,
        config: &LeaveConfig,
        position: &Vector3<f64>,
    ) -> Result<Option<Vector3<f64>>, ControlError> {
        match self {
            Self::Assumed | Self::Free => Ok(None),
            Self::Unknown => Err(ControlError::MayTouch { moved_m: None }),
            Self::Possible {
                normal,
                position: last,
            } => {
                let moved_m = (position - last).norm();
                // Written so that NaN is refused.
                if moved_m <= config.near_m {
                    return Ok(Some(*normal));
                }
                Err(ControlError::MayTouch {
                    moved_m: Some(moved_m),
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_that_is_not_the_stored_one_gives_no_way_out() {
        let config = LeaveConfig::default();
        let doubt = Clearance::Possible {
            normal: Vector3::z(),
            position: Vector3::new(0.4, 0.0, 0.2),
        };
        let near = doubt.way_out(&config, &Vector3::new(0.4, 0.01, 0.2));
        assert_eq!(near, Ok(Some(Vector3::z())));
        for away in [Vector3::new(0.4, 0.05, 0.2), Vector3::repeat(f64::NAN)] {
            let error = doubt.way_out(&config, &away).unwrap_err().to_string();
            assert!(error.contains("--clear"), "{error}");
        }
        assert!(
            Clearance::Unknown
                .way_out(&config, &Vector3::zeros())
                .is_err()
        );
        assert_eq!(
            Clearance::Free.way_out(&config, &Vector3::zeros()),
            Ok(None)
        );
    }
}
