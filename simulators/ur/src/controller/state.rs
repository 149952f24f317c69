//! State of the controller for its clients: RTDE outputs by name, and the summary for the other
//! ports.

use tangent_mechanics::Joints;
use tangent_rtde::codec::{DataType, Value, output_field};

use super::Controller;
use crate::modes::{RobotMode, RuntimeState, SafetyMode};

/// The state that the robot-state ports and the dashboard show.
#[derive(Clone, Copy, Debug)]
pub struct Summary {
    /// Time since the controller's start, s.
    pub time_s: f64,
    /// Power and brakes.
    pub robot_mode: RobotMode,
    /// Safety system.
    pub safety: SafetyMode,
    /// Program.
    pub runtime: RuntimeState,
    /// Measured joint positions, rad.
    pub q: Joints<6>,
    /// Positions the servo aims for, rad.
    pub q_target: Joints<6>,
    /// Measured joint speeds, rad/s.
    pub qd: Joints<6>,
    /// Speeds the servo aims for, rad/s.
    pub qd_target: Joints<6>,
    /// Accelerations the servo aims for, rad/s².
    pub qdd_target: Joints<6>,
    /// `base_from_tcp`, measured.
    pub tcp_pose: [f64; 6],
    /// `base_from_tcp`, target.
    pub tcp_pose_target: [f64; 6],
    /// Measured speed of the tool centre point, base axes, m/s and rad/s.
    pub tcp_speed: [f64; 6],
    /// Target speed of the tool centre point, base axes, m/s and rad/s.
    pub tcp_speed_target: [f64; 6],
    /// Force on the tool centre point (of an e-Series: on the flange), base axes, N and Nm.
    pub tcp_force: [f64; 6],
    /// Reading of the sensor in the flange of an e-Series, flange axes, N and Nm.
    pub ft_raw_wrench: [f64; 6],
    /// `flange_from_tcp`.
    pub tcp_offset: [f64; 6],
    /// Speed scaling by the limiter, 0 to 1.
    pub speed_scaling: f64,
    /// Position of the speed slider, 0 to 1.
    pub speed_slider: f64,
}

impl Controller {
    /// Power and brakes.
    pub fn robot_mode(&self) -> RobotMode {
        self.robot_mode
    }

    /// Safety system.
    pub fn safety(&self) -> SafetyMode {
        self.safety
    }

    /// Safety mode on the dashboard, which lags the true one.
    pub fn safety_on_dashboard(&self) -> SafetyMode {
        if self.time_s - self.safety_since_s < self.config.dashboard_lag_s {
            self.safety_before
        } else {
            self.safety
        }
    }

    /// Program.
    pub fn runtime(&self) -> RuntimeState {
        self.runtime
    }

    /// Whether a program runs.
    pub fn is_playing(&self) -> bool {
        self.runtime == RuntimeState::Playing
    }

    /// Name of the program that runs or is paused.
    pub fn program_name(&self) -> Option<&str> {
        self.machine.as_ref().map(|m| m.program().name())
    }

    /// Time since the controller's start, s.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// State that the robot-state ports show.
    pub fn summary(&self) -> Summary {
        let (arm, kinematics) = (&self.arm, &self.kinematics);
        Summary {
            time_s: self.time_s,
            robot_mode: self.robot_mode,
            safety: self.safety,
            runtime: self.runtime,
            q: arm.q,
            q_target: arm.q_target,
            qd: arm.qd,
            qd_target: arm.qd_target,
            qdd_target: self.qdd_target,
            tcp_pose: kinematics.pose(&arm.q),
            tcp_pose_target: kinematics.pose(&arm.q_target),
            tcp_speed: kinematics.speed(&arm.q, &arm.qd),
            tcp_speed_target: kinematics.speed(&arm.q_target, &arm.qd_target),
            tcp_force: self.tcp_force,
            ft_raw_wrench: self.ft_raw_wrench,
            tcp_offset: kinematics.tcp(),
            speed_scaling: self.planner.limiter(),
            speed_slider: self.slider,
        }
    }

    fn status_bits(&self) -> u32 {
        let powered = matches!(
            self.robot_mode,
            RobotMode::Idle | RobotMode::Running | RobotMode::PowerOn
        );
        u32::from(powered) | u32::from(self.is_playing()) << 1
    }

    fn joint_mode(&self) -> i32 {
        match self.robot_mode {
            RobotMode::Running => 253,
            RobotMode::Idle | RobotMode::PowerOn => 255,
            RobotMode::PowerOff | RobotMode::Booting => 239,
        }
    }

    /// Value of an RTDE output. Outputs that the simulated robot does not have read as at rest:
    /// zero, 48 V, 25 °C.
    pub fn output(&self, name: &str, s: &Summary) -> Value {
        let six = |q: &Joints<6>| Value::Vector6d((*q).into());
        match name {
            "timestamp" => Value::Double(s.time_s),
            "target_q" => six(&s.q_target),
            "target_qd" => six(&s.qd_target),
            "target_qdd" => six(&s.qdd_target),
            "actual_q" => six(&s.q),
            "actual_qd" => six(&s.qd),
            "target_moment" | "actual_current_as_torque" => {
                six(&self.kinematics.arm().gravity(&s.q_target))
            }
            "actual_TCP_pose" => Value::Vector6d(s.tcp_pose),
            "target_TCP_pose" => Value::Vector6d(s.tcp_pose_target),
            "actual_TCP_speed" => Value::Vector6d(s.tcp_speed),
            "target_TCP_speed" => Value::Vector6d(s.tcp_speed_target),
            "actual_TCP_force" => Value::Vector6d(s.tcp_force),
            "ft_raw_wrench" => Value::Vector6d(s.ft_raw_wrench),
            "tcp_force_scalar" => {
                let f = s.tcp_force;
                Value::Double((f[0] * f[0] + f[1] * f[1] + f[2] * f[2]).sqrt())
            }
            "tcp_offset" => Value::Vector6d(s.tcp_offset),
            "actual_digital_input_bits" => Value::Uint64(self.registers.digital_inputs),
            "actual_digital_output_bits" => Value::Uint64(self.registers.digital_outputs),
            "analog_io_types" => Value::Uint32(u32::from(self.registers.analog_types) << 2),
            "standard_analog_output0" => self.analog_output(0),
            "standard_analog_output1" => self.analog_output(1),
            "actual_tool_accelerometer" => Value::Vector3d([0.0, 0.0, -9.806_65]),
            "joint_temperatures" => Value::Vector6d([25.0; 6]),
            "tool_temperature" => Value::Double(25.0),
            "actual_main_voltage" | "actual_robot_voltage" => Value::Double(48.0),
            "actual_joint_voltage" => Value::Vector6d([48.0; 6]),
            "robot_mode" => Value::Int32(s.robot_mode.number()),
            "joint_mode" => Value::Vector6Int32([self.joint_mode(); 6]),
            "safety_mode" | "safety_status" => Value::Int32(s.safety.number()),
            "safety_status_bits" => Value::Uint32(s.safety.bits()),
            "robot_status_bits" => Value::Uint32(self.status_bits()),
            "runtime_state" => Value::Uint32(s.runtime.number()),
            "speed_scaling" => Value::Double(s.speed_scaling),
            "target_speed_fraction" => Value::Double(s.speed_slider),
            "payload" => Value::Double(self.payload_kg),
            "payload_cog" => Value::Vector3d(self.payload_centre_m),
            "tool_mode" => Value::Uint32(self.joint_mode() as u32),
            "script_control_line" => Value::Uint32(self.machine.as_ref().map_or(0, |m| m.line())),
            _ => self.registers.get(name).unwrap_or_else(|| {
                output_field(name)
                    .map_or(DataType::Double, |f| f.data_type)
                    .zero()
            }),
        }
    }

    /// Value of an analog output in V or A, as its type is set.
    fn analog_output(&self, n: usize) -> Value {
        let share = self.registers.analog_outputs[n];
        Value::Double(if self.registers.analog_types >> n & 1 == 1 {
            10.0 * share
        } else {
            0.004 + 0.016 * share
        })
    }
}
