//! The robot's 41 error flags.

use std::fmt;

/// Number of error flags.
pub const ERROR_COUNT: usize = 41;

/// Names of the flags, in the order of the state.
pub const ERROR_NAMES: [&str; ERROR_COUNT] = [
    "joint_position_limits_violation",
    "cartesian_position_limits_violation",
    "self_collision_avoidance_violation",
    "joint_velocity_violation",
    "cartesian_velocity_violation",
    "force_control_safety_violation",
    "joint_reflex",
    "cartesian_reflex",
    "max_goal_pose_deviation_violation",
    "max_path_pose_deviation_violation",
    "cartesian_velocity_profile_safety_violation",
    "joint_position_motion_generator_start_pose_invalid",
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
    "cartesian_position_motion_generator_start_pose_invalid",
    "cartesian_motion_generator_elbow_limit_violation",
    "cartesian_motion_generator_velocity_limits_violation",
    "cartesian_motion_generator_velocity_discontinuity",
    "cartesian_motion_generator_acceleration_discontinuity",
    "cartesian_motion_generator_elbow_sign_inconsistent",
    "cartesian_motion_generator_start_elbow_invalid",
    "force_controller_desired_force_tolerance_violation",
    "start_elbow_sign_inconsistent",
    "communication_constraints_violation",
    "power_limit_violation",
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
    "cartesian_position_motion_generator_invalid_frame_flag",
    "controller_torque_discontinuity",
    "joint_p2p_insufficient_torque_for_planning",
    "tau_J_range_violation",
    "instability_detected",
    "joint_move_in_wrong_direction",
    "cartesian_spline_motion_generator_violation",
    "joint_via_motion_generator_planning_joint_limit_violation",
    "base_acceleration_initialization_timeout",
    "base_acceleration_invalid_reading",
];

/// Flags that are set, in the order of [`ERROR_NAMES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorFlags(pub [bool; ERROR_COUNT]);

impl Default for ErrorFlags {
    fn default() -> Self {
        Self([false; ERROR_COUNT])
    }
}

impl ErrorFlags {
    /// A joint is beyond its limits; an operator has to guide it back by hand.
    pub const JOINT_POSITION_LIMITS: usize = 0;
    /// A joint is too fast.
    pub const JOINT_VELOCITY: usize = 3;
    /// A joint's external torque is beyond its threshold.
    pub const JOINT_REFLEX: usize = 6;
    /// The external force is beyond its threshold.
    pub const CARTESIAN_REFLEX: usize = 7;
    /// Too many answers lost in a row.
    pub const COMMUNICATION_CONSTRAINTS: usize = 25;
    /// A torque jumped.
    pub const TORQUE_DISCONTINUITY: usize = 32;
    /// A torque exceeds what the joint can produce.
    pub const TORQUE_RANGE: usize = 34;

    /// Only the flag `index` is set.
    pub fn only(index: usize) -> Self {
        let mut flags = Self::default();
        if let Some(flag) = flags.0.get_mut(index) {
            *flag = true;
        }
        flags
    }

    /// Whether no flag is set.
    pub fn is_empty(&self) -> bool {
        !self.0.contains(&true)
    }

    /// Names of the flags that are set.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.0
            .into_iter()
            .zip(ERROR_NAMES)
            .filter_map(|(set, name)| set.then_some(name))
    }
}

impl fmt::Display for ErrorFlags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, name) in self.names().enumerate() {
            if i > 0 {
                f.write_str(", ")?;
            }
            f.write_str(name)?;
        }
        Ok(())
    }
}
