//! `[limits]`: limits that the arm must never exceed.

use nalgebra::Vector3;
use serde::Deserialize;
use tangent_actuation::MotionLimits;
use tangent_mechanics::{Arm, Joints};
use tangent_schemas::JointArray;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// A list of limits whose length does not fit the arm.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("[limits] {key} has {got} values; 1 or {joints} are allowed for this arm")]
pub struct JointCountError {
    /// Key of the list in `[limits]`.
    pub key: &'static str,
    /// Its length.
    pub got: usize,
    /// Joints of the arm.
    pub joints: usize,
}

/// `[limits]`: the controller stays within them, and the guard of the robot's bridge checks its
/// commands as the last stage.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsConfig {
    /// Largest joint speed, rad/s; one number for all joints, or one per joint.
    pub joint_speed_max_rad_per_s: Vec<f64>,
    /// Largest joint acceleration, rad/s²; one number for all joints, or one per joint.
    pub joint_acceleration_max_rad_per_s2: Vec<f64>,
    /// Largest speed of the tool's origin, m/s.
    pub tool_speed_max_m_per_s: f64,
    /// Largest turn rate of the tool, rad/s.
    pub tool_turn_rate_max_rad_per_s: f64,
    /// Force at the tool beyond which the controller stops and retracts, N.
    pub force_max_n: f64,
    /// Torque at the tool beyond which the controller stops and retracts, Nm.
    pub torque_max_nm: f64,
    /// Force beyond which the controller retracts with any zero of the sensor, N: the untared
    /// reading compared with the last good zero. `None`: `force_max_n` plus 5 N.
    pub untared_force_max_n: Option<f64>,
    /// Force that the arm itself feels (`arm/wrench`) or its motors show, and the sensor does not,
    /// beyond which a tool that moves towards a surface retracts, N.
    pub unread_force_max_n: f64,
    /// Largest share of the sensor's range that the untared reading may take in any axis, 0 to 1;
    /// applies if no good zero is known.
    pub untared_share_max: f64,
    /// Distance into the surface that the tool may go without contact while it seeks a lost
    /// surface, and without an answer of the sensor, m.
    pub blind_distance_max_m: f64,
    /// Lower corner of the box in which the tool's origin must stay, base axes, m.
    pub workspace_min_m: [f64; 3],
    /// Upper corner of the box in which the tool's origin must stay, base axes, m.
    pub workspace_max_m: [f64; 3],
}

impl Default for LimitsConfig {
    fn default() -> Self {
        Self {
            joint_speed_max_rad_per_s: vec![1.0],
            joint_acceleration_max_rad_per_s2: vec![4.0],
            tool_speed_max_m_per_s: 0.25,
            tool_turn_rate_max_rad_per_s: 1.0,
            force_max_n: 40.0,
            torque_max_nm: 5.0,
            untared_force_max_n: None,
            unread_force_max_n: 30.0,
            untared_share_max: 0.7,
            blind_distance_max_m: 0.03,
            workspace_min_m: [-1.2, -1.2, -0.5],
            workspace_max_m: [1.2, 1.2, 1.5],
        }
    }
}

impl LimitsConfig {
    /// Largest joint speeds of an arm with `joints` joints, rad/s; `None` if the list has another
    /// length.
    pub fn joint_speed_max(&self, joints: usize) -> Option<JointArray> {
        per_joint(&self.joint_speed_max_rad_per_s, joints)
    }

    /// Largest joint accelerations of an arm with `joints` joints, rad/s²; `None` if the list has
    /// another length.
    pub fn joint_acceleration_max(&self, joints: usize) -> Option<JointArray> {
        per_joint(&self.joint_acceleration_max_rad_per_s2, joints)
    }

    /// Limits on the motion of `arm`, for the gate before it. The arm's own joint speed limits
    /// apply where they are lower; its joint ranges are its own.
    ///
    /// # Errors
    /// [`JointCountError`] if the joint speeds are for another number of joints.
    pub fn motion<const N: usize>(&self, arm: &Arm<N>) -> Result<MotionLimits<N>, JointCountError> {
        let own = arm.limits();
        let speed: Joints<N> =
            joints("joint_speed_max_rad_per_s", &self.joint_speed_max_rad_per_s)?;
        Ok(MotionLimits {
            speed_rad_per_s: speed.inf(&own.velocity),
            position_lower_rad: own.position_lower,
            position_upper_rad: own.position_upper,
            tool_speed_max_m_per_s: self.tool_speed_max_m_per_s,
            tool_turn_rate_max_rad_per_s: self.tool_turn_rate_max_rad_per_s,
            workspace_lower_m: Vector3::from(self.workspace_min_m),
            workspace_upper_m: Vector3::from(self.workspace_max_m),
        })
    }

    /// Largest joint accelerations of an arm with `N` joints, rad/s².
    ///
    /// # Errors
    /// [`JointCountError`] if the list is for another number of joints.
    pub fn joint_acceleration<const N: usize>(&self) -> Result<Joints<N>, JointCountError> {
        joints(
            "joint_acceleration_max_rad_per_s2",
            &self.joint_acceleration_max_rad_per_s2,
        )
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, list, most) in [
            (
                "limits.joint_speed_max_rad_per_s",
                &self.joint_speed_max_rad_per_s,
                10.0,
            ),
            (
                "limits.joint_acceleration_max_rad_per_s2",
                &self.joint_acceleration_max_rad_per_s2,
                100.0,
            ),
        ] {
            checker.require(
                matches!(list.len(), 1..=7),
                key,
                format!("{list:?}"),
                "a list of one number for all joints, or one per joint",
            )?;
            checker.ranges(key, list, 0.001..=most, "")?;
        }
        let ranges = [
            ("tool_speed_max_m_per_s", self.tool_speed_max_m_per_s, 3.0),
            (
                "tool_turn_rate_max_rad_per_s",
                self.tool_turn_rate_max_rad_per_s,
                10.0,
            ),
            ("force_max_n", self.force_max_n, 1000.0),
            ("torque_max_nm", self.torque_max_nm, 200.0),
            ("untared_share_max", self.untared_share_max, 1.0),
            ("blind_distance_max_m", self.blind_distance_max_m, 0.5),
            (
                "untared_force_max_n",
                self.untared_force_max_n.unwrap_or(1.0),
                1005.0,
            ),
        ];
        for (key, value, most) in ranges {
            checker.range(&format!("limits.{key}"), value, 0.001..=most, "")?;
        }
        checker.range(
            "limits.unread_force_max_n",
            self.unread_force_max_n,
            5.0..=1000.0,
            "N",
        )?;
        let ordered = (0..3).all(|i| self.workspace_min_m[i] < self.workspace_max_m[i]);
        checker.require(
            ordered,
            "limits.workspace_min_m",
            format!("{:?}", self.workspace_min_m),
            "every coordinate below that of limits.workspace_max_m",
        )?;
        checker.ranges(
            "limits.workspace_min_m",
            &self.workspace_min_m,
            -10.0..=10.0,
            "m",
        )?;
        checker.ranges(
            "limits.workspace_max_m",
            &self.workspace_max_m,
            -10.0..=10.0,
            "m",
        )
    }
}

fn joints<const N: usize>(key: &'static str, list: &[f64]) -> Result<Joints<N>, JointCountError> {
    per_joint(list, N)
        .and_then(|joints| <[f64; N]>::try_from(joints.as_slice()).ok())
        .map(Joints::from)
        .ok_or(JointCountError {
            key,
            got: list.len(),
            joints: N,
        })
}

fn per_joint(list: &[f64], joints: usize) -> Option<JointArray> {
    match list {
        [all] => Some(std::iter::repeat_n(*all, joints.min(7)).collect()),
        each if each.len() == joints => Some(each.iter().copied().collect()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use tangent_mechanics::ModelData;

    use super::*;

    #[test]
    fn the_arms_own_speed_limit_applies_where_it_is_lower() {
        let arm = Arm::<6>::new(&ModelData::builtin("ur5").unwrap()).unwrap();
        let mut limits = LimitsConfig {
            joint_speed_max_rad_per_s: vec![0.5, 0.5, 0.5, 0.5, 0.5, 100.0],
            ..LimitsConfig::default()
        };
        let motion = limits.motion(&arm).unwrap();
        assert_eq!(motion.speed_rad_per_s[0], 0.5);
        assert_eq!(motion.speed_rad_per_s[5], arm.limits().velocity[5]);
        limits.joint_speed_max_rad_per_s.pop();
        assert_eq!(
            limits.motion(&arm).unwrap_err().to_string(),
            "[limits] joint_speed_max_rad_per_s has 5 values; 1 or 6 are allowed for this arm"
        );
    }
}
