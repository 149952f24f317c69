//! The controller as a running program sees it.

use tangent_mechanics::Joints;
use tangent_urscript::{Compliance, ForceModeTuning, Motion, Robot, ScriptError, Sockets};

use super::{Action, Controller, Message, Watchdog};
use crate::config::Flavour;

/// Text messages of one program are cut to this many characters.
const TEXT_MAX: usize = 250;
/// Most watchdogs at once.
const WATCHDOGS_MAX: usize = 64;

fn array(joints: &Joints<6>) -> [f64; 6] {
    (*joints).into()
}

fn index(n: i32, count: usize) -> Option<usize> {
    usize::try_from(n).ok().filter(|n| *n < count)
}

impl Controller {
    fn q(&self, target: bool) -> &Joints<6> {
        if target {
            &self.arm.q_target
        } else {
            &self.arm.q
        }
    }

    fn qd(&self, target: bool) -> &Joints<6> {
        if target {
            &self.arm.qd_target
        } else {
            &self.arm.qd
        }
    }
}

impl Robot for Controller {
    fn step_s(&self) -> f64 {
        self.config.flavour.period_s()
    }

    fn is_e_series(&self) -> bool {
        self.config.flavour == Flavour::ESeries
    }

    fn speed_fraction(&self) -> f64 {
        self.slider
    }

    fn input_integer(&self, n: i32) -> Option<i32> {
        index(n, 48).map(|n| self.registers.input.integers[n])
    }

    fn input_float(&self, n: i32) -> Option<f64> {
        index(n, 48).map(|n| self.registers.input.doubles[n])
    }

    fn input_bit(&self, n: i32) -> Option<bool> {
        index(n, 128).map(|n| self.registers.input.bits >> n & 1 == 1)
    }

    fn output_integer(&mut self, n: i32) -> Option<&mut i32> {
        index(n, 48).map(|n| &mut self.registers.output.integers[n])
    }

    fn output_float(&mut self, n: i32) -> Option<&mut f64> {
        index(n, 48).map(|n| &mut self.registers.output.doubles[n])
    }

    fn output_bit(&self, n: i32) -> Option<bool> {
        index(n, 128).map(|n| self.registers.output.bits >> n & 1 == 1)
    }

    fn set_output_bit(&mut self, n: i32, on: bool) -> bool {
        let n = index(n, 128);
        if let Some(n) = n {
            self.registers.output.set_bit(n, on);
        }
        n.is_some()
    }

    fn digital_output(&self, n: i32) -> Option<bool> {
        index(n, 18).map(|n| self.registers.digital_outputs >> n & 1 == 1)
    }

    fn set_digital_output(&mut self, n: i32, on: bool) -> bool {
        let Some(n) = index(n, 18) else { return false };
        let bit = 1u64 << n;
        if on {
            self.registers.digital_outputs |= bit;
        } else {
            self.registers.digital_outputs &= !bit;
        }
        true
    }

    fn digital_input(&self, n: i32) -> Option<bool> {
        index(n, 18).map(|n| self.registers.digital_inputs >> n & 1 == 1)
    }

    fn analog_output(&mut self, n: i32) -> Option<&mut f64> {
        index(n, 2).map(|n| &mut self.registers.analog_outputs[n])
    }

    fn set_analog_output_voltage(&mut self, n: i32, voltage: bool) -> bool {
        let Some(n) = index(n, 2) else { return false };
        let types = self.registers.analog_types & !(1 << n);
        self.registers.analog_types = types | u8::from(voltage) << n;
        true
    }

    fn joint_positions(&self, target: bool) -> [f64; 6] {
        array(self.q(target))
    }

    fn joint_speeds(&self, target: bool) -> [f64; 6] {
        array(self.qd(target))
    }

    fn joint_torques(&self) -> [f64; 6] {
        array(&self.kinematics.arm().gravity(&self.arm.q))
    }

    fn tcp_pose(&self, target: bool) -> [f64; 6] {
        self.kinematics.pose(self.q(target))
    }

    fn tcp_speed(&self, target: bool) -> [f64; 6] {
        self.kinematics.speed(self.q(target), self.qd(target))
    }

    fn tcp_force(&self) -> [f64; 6] {
        self.tcp_force
    }

    fn tcp_offset(&self) -> [f64; 6] {
        self.kinematics.tcp()
    }

    fn set_tcp(&mut self, pose: [f64; 6]) {
        self.kinematics.set_tcp(&pose);
    }

    fn inverse(&self, pose: &[f64; 6], near: Option<[f64; 6]>) -> Option<[f64; 6]> {
        let near = near.map_or(self.arm.q, Joints::<6>::from);
        self.kinematics.inverse(pose, &near).map(|q| array(&q))
    }

    fn forward(&self, q: &[f64; 6], tcp: &[f64; 6]) -> [f64; 6] {
        self.kinematics.pose_with(&Joints::<6>::from(*q), tcp)
    }

    fn within_limits(&self, q: &[f64; 6]) -> bool {
        let limits = self.kinematics.arm().limits();
        limits.contains(&Joints::<6>::from(*q))
    }

    fn set_payload(&mut self, mass: f64, centre: Option<[f64; 3]>) {
        self.payload_kg = mass;
        if let Some(centre) = centre {
            self.payload_centre_m = centre;
        }
    }

    fn payload(&self) -> (f64, [f64; 3]) {
        (self.payload_kg, self.payload_centre_m)
    }

    fn start_motion(&mut self, motion: Motion) -> Result<(), ScriptError> {
        self.planner.start(motion, &self.arm, &self.kinematics);
        Ok(())
    }

    fn motion_done(&self) -> bool {
        self.planner.done()
    }

    fn moving(&self) -> bool {
        // A compliant arm may move without a motion of the program.
        if self.planner.is_compliant() {
            !self.planner.done()
        } else {
            self.arm.qd_target.amax() > 1e-3
        }
    }

    fn set_compliance(&mut self, compliance: Option<Compliance>) {
        self.planner.set_compliance(compliance);
    }

    fn tune_force_mode(&mut self, tuning: ForceModeTuning) {
        self.planner.tune_force_mode(tuning);
    }

    fn use_external_force(&mut self, enable: bool) {
        self.external_force_enabled = enable;
    }

    fn text_message(&mut self, text: String) {
        let text: String = text.chars().take(TEXT_MAX).collect();
        self.note(&format!("textmsg: {text}"));
        self.say(Message::Text(text));
    }

    fn popup(&mut self, text: String) {
        self.note(&format!("popup: {text}"));
        self.popup = Some(text);
    }

    fn popup_is_open(&self) -> bool {
        self.popup.is_some()
    }

    fn watchdog(&mut self, variable: &str, rate_hz: f64, action: &str) -> Result<(), ScriptError> {
        if tangent_rtde::codec::input_field(variable).is_none() {
            return Err(ScriptError::UnknownInput {
                variable: variable.to_owned(),
            });
        }
        let action = match action.to_ascii_lowercase().as_str() {
            "ignore" => Action::Ignore,
            "pause" => Action::Pause,
            "stop" => Action::Stop,
            other => {
                return Err(ScriptError::UnknownAction {
                    action: other.to_owned(),
                });
            }
        };
        self.watchdogs.retain(|w| w.variable != variable);
        if self.watchdogs.len() >= WATCHDOGS_MAX {
            return Err(ScriptError::TooManyWatchdogs {
                most: WATCHDOGS_MAX,
            });
        }
        self.watchdogs.push(Watchdog {
            variable: variable.to_owned(),
            period_s: 1.0 / rate_hz,
            action,
            updated_s: self.time_s,
        });
        Ok(())
    }

    fn protective_stop(&mut self) {
        self.protective_stop_wanted = true;
    }

    fn sockets(&mut self) -> &mut dyn Sockets {
        &mut self.network
    }
}
