//! URScript as clients send it to the simulated controller: compiled, then run for a bounded number
//! of cycles.

use tangent_urscript::{
    Compliance, ForceModeTuning, Frame, Machine, Motion, Program, Robot, ScriptError, SocketState,
    Sockets,
};

/// Number of cycles for which a program runs.
const CYCLES: u32 = 4;

/// Compiles a program for both series, and runs it, if it compiles, on an arm that stands still.
pub fn urscript(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    for e_series in [false, true] {
        let Ok(program) = Program::compile(text, e_series) else {
            continue;
        };
        let mut machine = Machine::new(program);
        let mut arm = Still {
            integers: [0; 48],
            floats: [0.0; 48],
            received: Vec::new(),
        };
        for _ in 0..CYCLES {
            if machine.frame(&mut arm) != Frame::Running {
                break;
            }
        }
    }
}

/// An arm that accepts every motion and never moves.
struct Still {
    integers: [i32; 48],
    floats: [f64; 48],
    received: Vec<u8>,
}

fn index(n: i32) -> Option<usize> {
    usize::try_from(n).ok().filter(|n| *n < 48)
}

impl Robot for Still {
    fn step_s(&self) -> f64 {
        0.008
    }
    fn is_e_series(&self) -> bool {
        false
    }
    fn speed_fraction(&self) -> f64 {
        1.0
    }
    fn input_integer(&self, n: i32) -> Option<i32> {
        index(n).map(|n| self.integers[n])
    }
    fn input_float(&self, n: i32) -> Option<f64> {
        index(n).map(|n| self.floats[n])
    }
    fn input_bit(&self, n: i32) -> Option<bool> {
        index(n).map(|_| false)
    }
    fn output_integer(&mut self, n: i32) -> Option<&mut i32> {
        index(n).map(|n| &mut self.integers[n])
    }
    fn output_float(&mut self, n: i32) -> Option<&mut f64> {
        index(n).map(|n| &mut self.floats[n])
    }
    fn output_bit(&self, n: i32) -> Option<bool> {
        index(n).map(|_| false)
    }
    fn set_output_bit(&mut self, n: i32, _: bool) -> bool {
        index(n).is_some()
    }
    fn digital_output(&self, n: i32) -> Option<bool> {
        index(n).filter(|n| *n < 18).map(|_| false)
    }
    fn set_digital_output(&mut self, n: i32, _: bool) -> bool {
        index(n).is_some_and(|n| n < 18)
    }
    fn digital_input(&self, n: i32) -> Option<bool> {
        index(n).filter(|n| *n < 18).map(|_| false)
    }
    fn analog_output(&mut self, n: i32) -> Option<&mut f64> {
        index(n).filter(|n| *n < 2).map(|n| &mut self.floats[n])
    }
    fn set_analog_output_voltage(&mut self, n: i32, _: bool) -> bool {
        index(n).is_some_and(|n| n < 2)
    }
    fn joint_positions(&self, _: bool) -> [f64; 6] {
        [0.0, -1.0, 1.0, -1.5, -1.5, 0.0]
    }
    fn joint_speeds(&self, _: bool) -> [f64; 6] {
        [0.0; 6]
    }
    fn joint_torques(&self) -> [f64; 6] {
        [0.0; 6]
    }
    fn tcp_pose(&self, _: bool) -> [f64; 6] {
        [0.4, 0.1, 0.3, 3.1, 0.0, 0.0]
    }
    fn tcp_speed(&self, _: bool) -> [f64; 6] {
        [0.0; 6]
    }
    fn tcp_force(&self) -> [f64; 6] {
        [0.0; 6]
    }
    fn tcp_offset(&self) -> [f64; 6] {
        [0.0; 6]
    }
    fn set_tcp(&mut self, _: [f64; 6]) {}
    fn inverse(&self, _: &[f64; 6], near: Option<[f64; 6]>) -> Option<[f64; 6]> {
        near
    }
    fn forward(&self, _: &[f64; 6], tcp: &[f64; 6]) -> [f64; 6] {
        *tcp
    }
    fn within_limits(&self, q: &[f64; 6]) -> bool {
        q.iter().all(|x| x.abs() < 6.3)
    }
    fn set_payload(&mut self, _: f64, _: Option<[f64; 3]>) {}
    fn payload(&self) -> (f64, [f64; 3]) {
        (0.0, [0.0; 3])
    }
    fn start_motion(&mut self, _: Motion) -> Result<(), ScriptError> {
        Ok(())
    }
    fn motion_done(&self) -> bool {
        true
    }
    fn moving(&self) -> bool {
        false
    }
    fn set_compliance(&mut self, _: Option<Compliance>) {}
    fn tune_force_mode(&mut self, _: ForceModeTuning) {}
    fn use_external_force(&mut self, _: bool) {}
    fn popup(&mut self, _: String) {}
    fn popup_is_open(&self) -> bool {
        false
    }
    fn text_message(&mut self, _: String) {}
    fn watchdog(&mut self, _: &str, _: f64, _: &str) -> Result<(), ScriptError> {
        Ok(())
    }
    fn protective_stop(&mut self) {}
    fn sockets(&mut self) -> &mut dyn Sockets {
        self
    }
}

/// A peer that sends back what it receives.
impl Sockets for Still {
    fn open(&mut self, _: &str, _: &str, _: u16) {}
    fn state(&mut self, _: &str) -> SocketState {
        SocketState::Open
    }
    fn close(&mut self, _: &str) -> bool {
        true
    }
    fn send(&mut self, _: &str, bytes: &[u8]) -> bool {
        self.received.extend_from_slice(bytes);
        self.received.truncate(4096);
        true
    }
    fn received(&mut self, _: &str) -> Option<&mut Vec<u8>> {
        Some(&mut self.received)
    }
}
