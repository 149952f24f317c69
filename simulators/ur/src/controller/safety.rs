//! Power, brakes and the safety system: causes of a stop, and the steps to leave it.

use super::{Controller, Message};
use crate::modes::{RobotMode, SafetyMode};

/// Time from a protective stop until it can be unlocked, s.
const UNLOCK_S: f64 = 5.0;
/// Time from an emergency stop until the power is off, s.
const POWER_CUT_S: f64 = 0.3;

impl Controller {
    pub(super) fn power(&mut self, dt: f64) {
        if self.safety.cuts_power()
            && self.robot_mode != RobotMode::PowerOff
            && self.time_s - self.safety_since_s > POWER_CUT_S
        {
            self.goal = RobotMode::PowerOff;
            self.robot_mode = RobotMode::PowerOff;
        }
        if self.robot_mode == self.goal {
            return;
        }
        self.step_left_s -= dt;
        if self.step_left_s > 0.0 {
            return;
        }
        self.step_left_s = self.config.power_step_s;
        self.robot_mode = match self.robot_mode {
            RobotMode::PowerOff => RobotMode::PowerOn,
            RobotMode::PowerOn => RobotMode::Idle,
            RobotMode::Idle => RobotMode::Running,
            other => other,
        };
    }

    /// Power to the arm; brakes stay engaged.
    pub fn power_on(&mut self) {
        if self.robot_mode == RobotMode::PowerOff && !self.safety.cuts_power() {
            self.goal = RobotMode::Idle;
            self.step_left_s = 0.0;
        }
    }

    /// Switches power on if necessary, then opens the brakes.
    pub fn release_brakes(&mut self) {
        if !self.safety.cuts_power() && self.robot_mode != RobotMode::Running {
            self.goal = RobotMode::Running;
            self.step_left_s = self.config.power_step_s;
        }
    }

    /// Switches power off and engages the brakes.
    pub fn power_off(&mut self) {
        self.end_program();
        self.planner.brake();
        self.goal = RobotMode::PowerOff;
        self.robot_mode = RobotMode::PowerOff;
    }

    /// Stops the arm with power on; the program ends (or pauses, as configured).
    pub fn protective_stop(&mut self, code: i32, argument: i32, reason: &str) {
        if self.safety.cuts_power() || self.safety == SafetyMode::ProtectiveStop {
            return;
        }
        self.note(&format!("protective stop C{code}A{argument}: {reason}"));
        self.say(Message::Error(code, argument, reason.to_owned()));
        self.set_safety(SafetyMode::ProtectiveStop);
        if self.config.protective_stop_pauses {
            self.pause();
        } else {
            self.end_program();
        }
        self.planner.brake();
    }

    /// Ends a protective stop, at the earliest 5 s after it began. Nothing moves by itself.
    ///
    /// # Errors
    /// Remaining time, s.
    pub fn unlock(&mut self) -> Result<(), f64> {
        if self.safety != SafetyMode::ProtectiveStop {
            return Ok(());
        }
        let left = UNLOCK_S - (self.time_s - self.safety_since_s);
        if left > 0.0 {
            return Err(left);
        }
        self.set_safety(SafetyMode::Normal);
        Ok(())
    }

    /// Presses the emergency button: the robot's own with `robot`, otherwise the cell's. With
    /// `pressed` false it is released; power stays off.
    pub fn emergency_stop(&mut self, robot: bool, pressed: bool) {
        if pressed {
            self.set_safety(if robot {
                SafetyMode::RobotEmergencyStop
            } else {
                SafetyMode::SystemEmergencyStop
            });
            self.end_program();
            self.planner.brake();
        } else if matches!(
            self.safety,
            SafetyMode::RobotEmergencyStop | SafetyMode::SystemEmergencyStop
        ) {
            self.set_safety(SafetyMode::Normal);
        }
    }

    /// Sets the safeguard input: open stops the arm and pauses the program, closed resumes it if so
    /// configured.
    pub fn safeguard(&mut self, open: bool) {
        if open && self.safety.allows_motion() {
            self.set_safety(SafetyMode::SafeguardStop);
            self.pause();
        } else if !open && self.safety == SafetyMode::SafeguardStop {
            self.set_safety(SafetyMode::Normal);
            if self.config.safeguard_resumes {
                self.resume();
            }
        }
    }

    /// Reduced mode on or off.
    pub fn reduced(&mut self, on: bool) {
        match (on, self.safety) {
            (true, SafetyMode::Normal) => self.set_safety(SafetyMode::Reduced),
            (false, SafetyMode::Reduced) => self.set_safety(SafetyMode::Normal),
            _ => {}
        }
    }

    /// Causes a safety fault or violation; only [`Controller::restart_safety`] ends it.
    pub fn safety_fault(&mut self, violation: bool) {
        self.set_safety(if violation {
            SafetyMode::Violation
        } else {
            SafetyMode::Fault
        });
        self.end_program();
        self.planner.brake();
    }

    /// Returns to normal mode with power off.
    pub fn restart_safety(&mut self) {
        self.power_off();
        self.set_safety(SafetyMode::Normal);
    }

    fn set_safety(&mut self, mode: SafetyMode) {
        if mode != self.safety {
            self.safety_before = self.safety;
            self.safety = mode;
            self.safety_since_s = self.time_s;
            self.say(Message::Safety(mode));
        }
    }
}
