//! Interface of the controller for a program.

use crate::error::ScriptError;
use crate::sockets::Sockets;

/// What a program reads and writes of the robot.
pub trait Robot {
    /// Control period, s.
    fn step_s(&self) -> f64;
    /// Whether it is an e-Series; otherwise a CB3.
    fn is_e_series(&self) -> bool;
    /// Speed slider, 0 to 1: time in motions runs this much slower.
    fn speed_fraction(&self) -> f64;
    /// Input register; `None` when there is no such register.
    fn input_integer(&self, n: i32) -> Option<i32>;
    /// Input register.
    fn input_float(&self, n: i32) -> Option<f64>;
    /// Input register.
    fn input_bit(&self, n: i32) -> Option<bool>;
    /// Output register, to read and to write.
    fn output_integer(&mut self, n: i32) -> Option<&mut i32>;
    /// Output register, to read and to write.
    fn output_float(&mut self, n: i32) -> Option<&mut f64>;
    /// Output register.
    fn output_bit(&self, n: i32) -> Option<bool>;
    /// Writes an output register; false when there is no such register.
    fn set_output_bit(&mut self, n: i32, on: bool) -> bool;
    /// Digital output: 0-7 standard, 8-15 configurable, 16-17 tool.
    fn digital_output(&self, n: i32) -> Option<bool>;
    /// Sets a digital output 0 to 17; false when there is no such output.
    fn set_digital_output(&mut self, n: i32, on: bool) -> bool;
    /// Digital input 0 to 17.
    fn digital_input(&self, n: i32) -> Option<bool>;
    /// Analog output 0 or 1, share of its range, to read and to write.
    fn analog_output(&mut self, n: i32) -> Option<&mut f64>;
    /// Makes an analog output a voltage (true) or a current; false when there is no such output.
    fn set_analog_output_voltage(&mut self, n: i32, voltage: bool) -> bool;
    /// Joint positions, rad: measured, or those the servo aims for.
    fn joint_positions(&self, target: bool) -> [f64; 6];
    /// Joint speeds, rad/s.
    fn joint_speeds(&self, target: bool) -> [f64; 6];
    /// Joint torques, Nm.
    fn joint_torques(&self) -> [f64; 6];
    /// Pose of the tool centre point, base axes, m and rotation vector.
    fn tcp_pose(&self, target: bool) -> [f64; 6];
    /// Speed of the tool centre point, base axes, m/s and rad/s.
    fn tcp_speed(&self, target: bool) -> [f64; 6];
    /// Force on the tool centre point, base axes, N and Nm.
    fn tcp_force(&self) -> [f64; 6];
    /// `flange_from_tcp`.
    fn tcp_offset(&self) -> [f64; 6];
    /// Sets `flange_from_tcp`.
    fn set_tcp(&mut self, pose: [f64; 6]);
    /// Joint positions for a pose of the tool centre point, near `near` or the present ones.
    fn inverse(&self, pose: &[f64; 6], near: Option<[f64; 6]>) -> Option<[f64; 6]>;
    /// Pose of a tool centre point `tcp` on the flange at `q`.
    fn forward(&self, q: &[f64; 6], tcp: &[f64; 6]) -> [f64; 6];
    /// Joint positions within the limits.
    fn within_limits(&self, q: &[f64; 6]) -> bool;
    /// Sets mass, kg, and centre of gravity, m.
    fn set_payload(&mut self, mass: f64, centre: Option<[f64; 3]>);
    /// Mass, kg, and centre of gravity, m, as set.
    fn payload(&self) -> (f64, [f64; 3]);
    /// Begins a motion, replacing the one under way.
    fn start_motion(&mut self, motion: Motion) -> Result<(), ScriptError>;
    /// Whether the motion begun last has ended.
    fn motion_done(&self) -> bool;
    /// Whether a motion of the program moves the arm.
    fn moving(&self) -> bool;
    /// Makes the arm compliant along some axes, until [`Robot::set_compliance`] with `None`.
    fn set_compliance(&mut self, compliance: Option<Compliance>);
    /// Sets the damping, 0 to 1, or the gain, 0 to 2, of the force mode.
    fn tune_force_mode(&mut self, tuning: ForceModeTuning);
    /// Takes the force from the RTDE input `external_force_torque`, or no longer.
    fn use_external_force(&mut self, enable: bool);
    /// Adds a line to the log and sends it to clients.
    fn text_message(&mut self, text: String);
    /// Shows a message that stays until an operator closes it.
    fn popup(&mut self, text: String);
    /// Whether a message is shown.
    fn popup_is_open(&self) -> bool;
    /// Monitors an input variable.
    fn watchdog(&mut self, variable: &str, rate_hz: f64, action: &str) -> Result<(), ScriptError>;
    /// Causes a protective stop.
    fn protective_stop(&mut self);
    /// TCP connections of the program.
    fn sockets(&mut self) -> &mut dyn Sockets;
}

/// A motion that a program requests.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// Joint velocity.
    SpeedJ {
        /// Joint velocity, rad/s.
        qd: [f64; 6],
        /// Acceleration, rad/s².
        a: f64,
    },
    /// Velocity of the tool centre point.
    SpeedL {
        /// Velocity, base axes, m/s and rad/s.
        xd: [f64; 6],
        /// Acceleration, m/s².
        a: f64,
    },
    /// Position to follow.
    ServoJ {
        /// Joint positions, rad.
        q: [f64; 6],
        /// Smoothing time, s.
        lookahead_s: f64,
    },
    /// Moves all joints at once to joint positions.
    MoveJ {
        /// Joint positions, rad.
        q: [f64; 6],
        /// Acceleration of the leading axis, rad/s².
        a: f64,
        /// Speed of the leading axis, rad/s.
        v: f64,
        /// Duration instead of `a` and `v`, s.
        t: f64,
    },
    /// Moves in a straight line.
    MoveL {
        /// Target `base_from_tcp`.
        pose: [f64; 6],
        /// Acceleration, m/s².
        a: f64,
        /// Speed, m/s.
        v: f64,
        /// Duration instead of `a` and `v`, s.
        t: f64,
    },
    /// Moves in a circular arc.
    MoveC {
        /// A point of the arc: only its position counts.
        via: [f64; 6],
        /// Target `base_from_tcp`.
        to: [f64; 6],
        /// Acceleration, m/s².
        a: f64,
        /// Speed, m/s.
        v: f64,
        /// The orientation turns with the arc; otherwise it turns to that of the target.
        follows_arc: bool,
    },
    /// Decelerates to a stop.
    Stop {
        /// Deceleration, rad/s².
        a: f64,
    },
}

/// How the arm yields: force mode, or freedrive.
#[derive(Clone, Debug, PartialEq)]
pub struct Compliance {
    /// Axes in which the rest is given.
    pub frame: TaskFrame,
    /// Axes along and about which the arm yields.
    pub selection: [bool; 6],
    /// Force and torque that the tool applies to its surroundings, N and Nm.
    pub wrench: [f64; 6],
    /// Highest speed along and about each compliant axis, m/s and rad/s.
    pub speed_max: [f64; 6],
    /// A hand moves the arm: it yields more easily than in force mode.
    pub hand_guided: bool,
}

/// Axes of a [`Compliance`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TaskFrame {
    /// Those of a pose in the base.
    Fixed([f64; 6]),
    /// Those of the tool centre point.
    Tool,
    /// y points from the tool centre point to the origin of this pose.
    TowardsOrigin([f64; 6]),
    /// x is the velocity of the tool centre point, projected on the xy plane of this pose.
    AlongMotion([f64; 6]),
}

/// One setting of the force mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ForceModeTuning {
    /// 0 to 1.
    Damping(f64),
    /// 0 to 2.
    Gain(f64),
}
