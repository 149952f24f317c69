//! Where the arm starts a task, and where it stands after it: `[start]` and `[home]` of a task
//! file.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// Joint positions from which a task starts. The arm travels there first, straight in joint space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartSpec {
    /// Joint positions, base to flange, rad.
    pub joints_rad: Vec<f64>,
    /// Highest joint speed on the way, rad/s.
    #[serde(default = "speed")]
    pub speed_rad_per_s: f64,
    /// Distance of any joint within which the arm counts as standing there, rad.
    #[serde(default = "tolerance")]
    pub tolerance_rad: f64,
    /// Change of the measured force that stops the arm on the way, N.
    #[serde(default = "force")]
    pub force_max_n: f64,
}

fn speed() -> f64 {
    0.2
}

fn tolerance() -> f64 {
    0.01
}

fn force() -> f64 {
    5.0
}

impl StartSpec {
    /// A start with all other settings at their defaults.
    pub fn at(joints_rad: Vec<f64>) -> Self {
        Self {
            joints_rad,
            speed_rad_per_s: speed(),
            tolerance_rad: tolerance(),
            force_max_n: force(),
        }
    }

    /// Checks that every number is in its range; `table` is `start` or `home`.
    pub(super) fn check(&self, table: &str) -> Result<(), ControlError> {
        let key = |name: &str| format!("{table}.{name}");
        if !(6..=7).contains(&self.joints_rad.len()) {
            return Err(ControlError::range(
                key("joints_rad"),
                format!("{} numbers", self.joints_rad.len()),
                "one number per joint of the arm: six or seven",
            ));
        }
        let turn = 2.0 * std::f64::consts::TAU;
        for joint in &self.joints_rad {
            check_range(&key("joints_rad"), *joint, -turn, turn)?;
        }
        check_range(&key("speed_rad_per_s"), self.speed_rad_per_s, 0.01, 1.0)?;
        check_range(&key("tolerance_rad"), self.tolerance_rad, 0.002, 0.2)?;
        check_range(&key("force_max_n"), self.force_max_n, 0.5, 50.0)
    }

    /// The joint positions for an arm of `N` joints; `table` is `start` or `home`.
    ///
    /// # Errors
    /// The number of joints differs.
    pub(crate) fn joints<const N: usize>(
        &self,
        table: &str,
    ) -> Result<tangent_mechanics::Joints<N>, ControlError> {
        if self.joints_rad.len() != N {
            return Err(ControlError::range(
                format!("{table}.joints_rad"),
                format!("{} numbers", self.joints_rad.len()),
                &format!("{N} numbers, one per joint of this arm"),
            ));
        }
        Ok(tangent_mechanics::Joints::from_column_slice(
            &self.joints_rad,
        ))
    }
}
