//! The controller without its sockets: modes, safety, program and motion, one control cycle per
//! call.
//!
//! The cell's thread calls [`Controller::cycle`] once per period and the servers call the rest in
//! between. Time is the controller's own: it counts cycles.

pub use state::Summary;

mod force;
mod robot;
mod safety;
mod state;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use nalgebra::UnitQuaternion;
use tangent_mechanics::{Joints, ModelError};
use tangent_rtde::codec::Value;
use tangent_rtde::dashboard::ur_size;
use tangent_simulation::{ArmMeasurement, VelocityCommand};
use tangent_urscript::{Frame, Machine, Program};

use crate::config::{ControllerConfig, Flavour};
use crate::kinematics::Kinematics;
use crate::modes::{RobotMode, RuntimeState, SafetyMode};
use crate::motion::Planner;
use crate::network::Network;
use crate::own_sensor::OwnReading;
use crate::registers::Registers;

/// Messages kept for clients that have not been served yet.
const MESSAGES_MAX: usize = 256;

/// Messages of the controller to its clients besides its state.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A program started or stopped: title and program name.
    Key(&'static str, String),
    /// Text of a program's `textmsg`.
    Text(String),
    /// A code as in the controller's log, C`code`A`argument`, and its text.
    Error(i32, i32, String),
    /// A program failed: line, column, what was wrong.
    Exception(u32, u32, String),
    /// The safety mode changed.
    Safety(SafetyMode),
}

/// A controller's state.
#[derive(Debug)]
pub struct Controller {
    config: ControllerConfig,
    kinematics: Kinematics,
    robot_model: String,
    /// Registers, inputs and outputs.
    pub registers: Registers,
    arm: ArmMeasurement,
    qd_target_before: Joints<6>,
    qdd_target: Joints<6>,
    tcp_force: [f64; 6],
    ft_raw_wrench: [f64; 6],
    time_s: f64,
    robot_mode: RobotMode,
    goal: RobotMode,
    step_left_s: f64,
    safety: SafetyMode,
    safety_since_s: f64,
    safety_before: SafetyMode,
    runtime: RuntimeState,
    machine: Option<Machine>,
    waiting: Option<(f64, Program)>,
    secondary: Option<Machine>,
    planner: Planner,
    slider: f64,
    slider_was_zero: bool,
    watchdogs: Vec<Watchdog>,
    payload_kg: f64,
    payload_centre_m: [f64; 3],
    messages: VecDeque<Message>,
    log: VecDeque<String>,
    protective_stop_wanted: bool,
    network: Network,
    popup: Option<String>,
    external_force_enabled: bool,
    push: [f64; 6],
}

#[derive(Clone, Debug)]
struct Watchdog {
    variable: String,
    period_s: f64,
    action: Action,
    updated_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Ignore,
    Pause,
    Stop,
}

impl Controller {
    /// Creates a controller with power as configured and no program. `model` names a built-in arm,
    /// `arm` is its present state.
    ///
    /// # Errors
    /// The model is unknown.
    pub fn new(
        config: &ControllerConfig,
        model: &str,
        arm: ArmMeasurement,
    ) -> Result<Self, ModelError> {
        let kinematics = Kinematics::builtin(model)?;
        let robot_model = format!("UR{}", ur_size(model).unwrap_or(5));
        Ok(Self::fresh(config.clone(), kinematics, robot_model, arm))
    }

    /// Restarts as after a reset: registers cleared, no program, time from 0. Power stays off
    /// unless configured on. The tool centre point is kept.
    pub fn restart(&mut self) {
        *self = Self {
            time_s: 0.0,
            ..Self::fresh(
                self.config.clone(),
                self.kinematics.clone(),
                std::mem::take(&mut self.robot_model),
                self.arm,
            )
        };
    }

    /// A controller that has just booted, at the configured time.
    fn fresh(
        config: ControllerConfig,
        kinematics: Kinematics,
        robot_model: String,
        arm: ArmMeasurement,
    ) -> Self {
        let mode = if config.running {
            RobotMode::Running
        } else {
            RobotMode::PowerOff
        };
        Self {
            kinematics,
            robot_model,
            registers: Registers::default(),
            arm,
            qd_target_before: Joints::<6>::zeros(),
            qdd_target: Joints::<6>::zeros(),
            tcp_force: [0.0; 6],
            ft_raw_wrench: [0.0; 6],
            time_s: config.timestamp_s,
            robot_mode: mode,
            goal: mode,
            step_left_s: 0.0,
            safety: SafetyMode::Normal,
            safety_since_s: f64::NEG_INFINITY,
            safety_before: SafetyMode::Normal,
            runtime: RuntimeState::Stopped,
            machine: None,
            waiting: None,
            secondary: None,
            planner: Planner::default(),
            slider: 1.0,
            slider_was_zero: false,
            watchdogs: Vec::new(),
            payload_kg: 0.0,
            payload_centre_m: [0.0; 3],
            messages: VecDeque::new(),
            log: VecDeque::new(),
            protective_stop_wanted: false,
            network: Network::default(),
            popup: None,
            external_force_enabled: false,
            push: [0.0; 6],
            config,
        }
    }

    /// Model name as on the dashboard, such as `UR10`: without the e of an e-Series arm, and `UR5`
    /// for an arm of another manufacturer.
    pub fn robot_model(&self) -> &str {
        &self.robot_model
    }

    /// The configuration.
    pub fn config(&self) -> &ControllerConfig {
        &self.config
    }

    /// Runs one control cycle: takes the arm's measurements and returns its command.
    pub fn cycle(&mut self, arm: ArmMeasurement, tcp_force: [f64; 6]) -> VelocityCommand {
        self.observe(arm, tcp_force);
        self.act()
    }

    /// First half of a cycle: takes the arm's measurements, which clients see from now on.
    pub fn observe(&mut self, arm: ArmMeasurement, tcp_force: [f64; 6]) {
        let dt = self.config.flavour.period_s();
        self.time_s += dt;
        self.qdd_target = (arm.qd_target - self.qd_target_before) / dt;
        self.qd_target_before = arm.qd_target;
        self.arm = arm;
        self.set_force(&tcp_force);
    }

    /// Takes the reading of the sensor in the flange, which replaces the force of the present
    /// cycle: after [`Controller::observe`], of an e-Series arm.
    pub fn feel(&mut self, reading: &OwnReading) {
        self.set_force(&reading.tcp_force);
        self.ft_raw_wrench = reading.ft_raw_wrench;
    }

    /// Orientation of the flange in the base, by the measured joint angles.
    pub fn base_from_flange(&self) -> UnitQuaternion<f64> {
        self.kinematics
            .arm()
            .base_from_flange(&self.arm.q)
            .rotation()
    }

    /// Second half of a cycle: returns the arm's command, given all inputs that have arrived.
    pub fn act(&mut self) -> VelocityCommand {
        let dt = self.config.flavour.period_s();
        self.power(dt);
        self.watch();
        self.launch();
        self.run_frame();
        if std::mem::take(&mut self.protective_stop_wanted) {
            self.protective_stop(0, 0, "protective_stop() of the program");
        }
        let slider = if self.safety == SafetyMode::Reduced {
            self.slider.min(0.5)
        } else {
            self.slider
        };
        let force = self.tcp_force_at_tcp();
        self.planner
            .step(&self.arm, &self.kinematics, &force, dt, slider)
    }

    fn watch(&mut self) {
        let tripped = self
            .watchdogs
            .iter()
            .find(|w| w.action != Action::Ignore && self.time_s - w.updated_s > w.period_s)
            .cloned();
        let Some(watchdog) = tripped else { return };
        self.watchdogs.clear();
        let text = format!("RTDE watchdog: {} was not updated", watchdog.variable);
        match watchdog.action {
            // CB3 reports a lost fieldbus and stops protectively. For e-Series, no other behaviour
            // is known.
            Action::Stop => self.protective_stop(207, 0, &text),
            Action::Pause => {
                self.say(Message::Error(207, 0, text));
                self.pause();
            }
            Action::Ignore => {}
        }
    }

    fn launch(&mut self) {
        let due = self
            .waiting
            .as_ref()
            .is_some_and(|(at, _)| self.time_s >= *at);
        if !due {
            return;
        }
        let Some((_, program)) = self.waiting.take() else {
            return;
        };
        if self.robot_mode != RobotMode::Running || !self.safety.allows_motion() {
            self.note("a program was not started: the robot is not running");
            return;
        }
        self.end_program();
        self.say(Message::Key(
            "PROGRAM_XXX_STARTED",
            program.name().to_owned(),
        ));
        self.machine = Some(Machine::new(program));
        self.runtime = RuntimeState::Playing;
    }

    fn run_frame(&mut self) {
        if let Some(mut secondary) = self.secondary.take() {
            // A secondary program has only this frame.
            match secondary.frame(self) {
                Frame::Ended => {}
                Frame::Running => {
                    self.say(Message::Exception(
                        0,
                        0,
                        "Runtime is too much behind".to_owned(),
                    ));
                }
                Frame::Failed(error) => self.say(Message::Exception(
                    error.line,
                    error.column,
                    error.cause.to_string(),
                )),
            }
        }
        if self.runtime != RuntimeState::Playing {
            return;
        }
        let Some(mut machine) = self.machine.take() else {
            return;
        };
        let frame = machine.frame(self);
        self.machine = Some(machine);
        match frame {
            Frame::Running => {
                let idle = !self.machine.as_ref().is_some_and(Machine::in_motion);
                if self.config.speedj_stops_after_t && idle && self.planner.holds_speed() {
                    self.planner.brake();
                }
            }
            Frame::Ended => self.end_program(),
            Frame::Failed(error) => {
                let text = error.cause.to_string();
                self.note(&format!("program failed at line {}: {text}", error.line));
                self.say(Message::Exception(error.line, error.column, text.clone()));
                self.end_program();
                if error.is_overrun() {
                    self.protective_stop(0, 0, &text);
                }
            }
        }
    }

    /// Ends the program and its watchdogs; an arm that moves fast is stopped.
    fn end_program(&mut self) {
        self.waiting = None;
        self.watchdogs.clear();
        self.network.close_all();
        self.planner.reset_compliance();
        self.popup = None;
        if let Some(machine) = self.machine.take() {
            let name = machine.program().name().to_owned();
            self.say(Message::Key("PROGRAM_XXX_STOPPED", name));
            let speed = self.arm.qd_target.amax();
            if speed > self.config.program_end_speed_max_rad_per_s && self.safety.allows_motion() {
                self.protective_stop(
                    153,
                    0,
                    &format!("the program ended while a joint moved at {speed:.2} rad/s"),
                );
            }
            self.planner.brake();
        }
        self.runtime = RuntimeState::Stopped;
    }

    /// Takes the complete text of a program from a script port. The program starts after its
    /// compile time.
    pub fn upload(&mut self, text: &str) {
        let e_series = self.config.flavour == Flavour::ESeries;
        match Program::compile(text, e_series) {
            Ok(program) if program.is_secondary() => self.secondary = Some(Machine::new(program)),
            Ok(program) => {
                let lines = text.lines().count() as f64;
                let start = self.config.program_start_s + lines * self.config.compile_s_per_line;
                // The arrival of a new program stops the running one.
                self.end_program();
                self.waiting = Some((self.time_s + start, program));
            }
            Err(error) => {
                self.note(&format!("a program was refused: {error}"));
                if error.unknown_name {
                    self.say(Message::Exception(error.line, error.column, error.reason));
                }
            }
        }
    }

    /// Ends the program.
    pub fn stop_program(&mut self) {
        self.end_program();
    }

    /// Pauses the program; the arm stops.
    pub fn pause(&mut self) {
        if self.runtime == RuntimeState::Playing {
            self.runtime = RuntimeState::Paused;
            self.planner.brake();
        }
    }

    /// Resumes a paused program; false if there is none or the robot is not ready.
    pub fn resume(&mut self) -> bool {
        let ready = self.robot_mode == RobotMode::Running && self.safety.allows_motion();
        if self.runtime == RuntimeState::Paused && ready {
            let now = self.time_s;
            self.watchdogs.iter_mut().for_each(|w| w.updated_s = now);
            self.runtime = RuntimeState::Playing;
            return true;
        }
        false
    }

    /// Takes one input package: registers, outputs, speed slider; feeds the watchdogs.
    pub fn write_inputs(&mut self, names: &[String], values: &[Value]) {
        self.registers.write(names, values);
        let now = self.time_s;
        for watchdog in &mut self.watchdogs {
            if names.contains(&watchdog.variable) {
                watchdog.updated_s = now;
            }
        }
        let value = |name: &str| {
            names
                .iter()
                .position(|n| n == name)
                .and_then(|at| values.get(at))
        };
        if let (Some(Value::Uint32(mask)), Some(Value::Double(fraction))) =
            (value("speed_slider_mask"), value("speed_slider_fraction"))
            && *mask != 0
        {
            self.set_slider(*fraction);
        }
    }

    /// Sets the speed slider, 0 to 1. When it leaves zero again, the controller stops protectively.
    pub fn set_slider(&mut self, fraction: f64) {
        if !fraction.is_finite() {
            return;
        }
        self.slider = fraction.clamp(0.0, 1.0);
        if self.slider == 0.0 {
            self.slider_was_zero = true;
        } else if std::mem::take(&mut self.slider_was_zero) {
            self.protective_stop(204, 2, "the speed slider was raised from zero");
        }
    }

    /// Closes the message that a program shows, as an operator does.
    pub fn close_popup(&mut self) {
        self.popup = None;
    }

    fn say(&mut self, message: Message) {
        if self.messages.len() < MESSAGES_MAX {
            self.messages.push_back(message);
        }
    }

    fn note(&mut self, line: &str) {
        tracing::info!(target: "simulator", "controller: {line}");
        if self.log.len() >= MESSAGES_MAX {
            self.log.pop_front();
        }
        self.log.push_back(line.to_owned());
    }

    /// Adds a client's line to the log.
    pub fn log_line(&mut self, line: &str) {
        self.note(line);
    }

    /// The newest lines of the log, oldest first.
    pub fn log(&self) -> impl Iterator<Item = &str> {
        self.log.iter().map(String::as_str)
    }

    /// The messages since the last call.
    pub fn take_messages(&mut self) -> Vec<Message> {
        self.messages.drain(..).collect()
    }
}
