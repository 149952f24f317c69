//! Modes in the robot's state.

use std::fmt;

use super::wire::numbered;

numbered! {
    /// `robot_mode` of the state.
    pub enum RobotMode: u8 {
        /// Any other mode.
        Other = 0,
        /// Holds itself, ready for a motion.
        Idle = 1,
        /// A motion of a client runs.
        Move = 2,
        /// Guided by hand.
        Guiding = 3,
        /// Stopped by a reflex.
        Reflex = 4,
        /// The external activation device (user stop) is pressed.
        UserStopped = 5,
        /// Recovering from a reflex.
        AutomaticErrorRecovery = 6,
    }
}

impl fmt::Display for RobotMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Other => "in an unknown mode",
            Self::Idle => "idle",
            Self::Move => "moving",
            Self::Guiding => "guided by hand",
            Self::Reflex => "stopped by a reflex",
            Self::UserStopped => "stopped by its user stop",
            Self::AutomaticErrorRecovery => "recovering",
        })
    }
}

numbered! {
    /// `motion_generator_mode` of the state. A torque motion runs with a joint velocity generator
    /// of zeros: this version has no mode without a generator.
    pub enum MotionMode: u8 {
        /// No motion generator runs.
        Idle = 0,
        /// Joint positions.
        JointPosition = 1,
        /// Joint velocities.
        JointVelocity = 2,
        /// Poses.
        CartesianPosition = 3,
        /// Twists.
        CartesianVelocity = 4,
    }
}

numbered! {
    /// `controller_mode` of the state.
    pub enum ControllerMode: u8 {
        /// The robot's own controller, in joint space.
        JointImpedance = 0,
        /// The robot's own controller, in Cartesian space.
        CartesianImpedance = 1,
        /// The client's torques.
        External = 2,
        /// Any other controller.
        Other = 3,
    }
}
