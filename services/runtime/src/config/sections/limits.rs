//! `[limits]`: what the arm may never exceed.

use serde::Deserialize;
use tangent_schemas::JointArray;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[limits]`: the last guard, in `rtde`; the controller keeps inside them too.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsConfig {
    /// rad/s; one number for all joints, or one per joint.
    pub joint_speed_max_rad_per_s: Vec<f64>,
    /// rad/s²; one number for all joints, or one per joint.
    pub joint_acceleration_max_rad_per_s2: Vec<f64>,
    /// Speed of the tool's origin, m/s.
    pub tool_speed_max_m_per_s: f64,
    /// Turn rate of the tool, rad/s.
    pub tool_turn_rate_max_rad_per_s: f64,
    /// The controller stops and retracts beyond this force, N.
    pub force_max_n: f64,
    /// The same for torque at the tool, Nm.
    pub torque_max_nm: f64,
    /// Force beyond which the controller retracts whatever the sensor's zero, N: the untared reading against the last good zero.
    /// None: `force_max_n` and 5 N.
    pub untared_force_max_n: Option<f64>,
    /// Where no good zero is known: largest share of the sensor's range that the untared reading may take in any axis, 0 to 1.
    pub untared_share_max: f64,
    /// The tool's origin stays inside this box: lower corner, base axes, m.
    pub workspace_min_m: [f64; 3],
    /// Upper corner, base axes, m.
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
            untared_share_max: 0.7,
            workspace_min_m: [-1.2, -1.2, -0.5],
            workspace_max_m: [1.2, 1.2, 1.5],
        }
    }
}

impl LimitsConfig {
    /// rad/s for an arm of `joints` joints; `None` when the list has another length.
    pub fn joint_speed_max(&self, joints: usize) -> Option<JointArray> {
        per_joint(&self.joint_speed_max_rad_per_s, joints)
    }

    /// rad/s² for an arm of `joints` joints; `None` when the list has another length.
    pub fn joint_acceleration_max(&self, joints: usize) -> Option<JointArray> {
        per_joint(&self.joint_acceleration_max_rad_per_s2, joints)
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
            (
                "untared_force_max_n",
                self.untared_force_max_n.unwrap_or(1.0),
                1005.0,
            ),
        ];
        for (key, value, most) in ranges {
            checker.range(&format!("limits.{key}"), value, 0.001..=most, "")?;
        }
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

fn per_joint(list: &[f64], joints: usize) -> Option<JointArray> {
    match list {
        [all] => Some(std::iter::repeat_n(*all, joints.min(7)).collect()),
        each if each.len() == joints => Some(each.iter().copied().collect()),
        _ => None,
    }
}
