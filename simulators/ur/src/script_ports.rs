//! The ports that take script text and stream the robot's state: primary, secondary, real-time, and
//! their read-only twins.

use std::net::TcpListener;
use std::time::Instant;

use tangent_urscript::PROGRAM_BYTES_MAX;

use crate::config::Flavour;
use crate::connection::{Connection, accept};
use crate::controller::{Controller, Message};
use crate::primary::{self, Geometry};

/// Stream of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// State at 10 Hz and all messages.
    Primary,
    /// State at 10 Hz.
    Secondary,
    /// The real-time package every cycle.
    Realtime,
}

/// One port and its clients.
#[derive(Debug)]
pub struct ScriptPort {
    listener: TcpListener,
    stream: Stream,
    read_only: bool,
    clients: Vec<(Connection, Collector)>,
    next_state_s: f64,
    /// Buffer of the state package. Its memory is kept, since a thread that holds the allocator's
    /// lock must not delay the robot.
    state: Vec<u8>,
}

impl ScriptPort {
    /// Creates a server for a non-blocking listener.
    pub fn new(listener: TcpListener, stream: Stream, read_only: bool) -> Self {
        Self {
            listener,
            stream,
            read_only,
            clients: Vec::new(),
            next_state_s: f64::NEG_INFINITY,
            state: Vec::with_capacity(2048),
        }
    }

    /// Disconnects all clients.
    pub fn disconnect_all(&mut self) {
        self.clients.clear();
        self.next_state_s = f64::NEG_INFINITY;
    }

    /// Accepts new clients and reads what they have sent.
    pub fn poll(&mut self, controller: &mut Controller, now: Instant) {
        let flavour = controller.config().flavour;
        for mut connection in accept(&self.listener, self.clients.len()) {
            if self.stream != Stream::Realtime {
                connection.send(&primary::version(flavour, controller.time_s()), now);
            }
            self.clients.push((connection, Collector::default()));
        }
        let local = flavour == Flavour::ESeries && !controller.config().remote_control;
        let mut incoming = Vec::new();
        for (connection, collector) in &mut self.clients {
            incoming.clear();
            connection.read(&mut incoming);
            if incoming.is_empty() {
                continue;
            }
            if self.read_only || local {
                let text = "the connection is read-only".to_owned();
                let refusal = Message::Error(210, 0, text);
                connection.send(&primary::message(&refusal, controller.time_s()), now);
                continue;
            }
            let Ok(items) = collector.push(&incoming) else {
                tracing::warn!(target: "simulator", "{}: a program without an end", connection.peer());
                connection.close();
                continue;
            };
            for item in items {
                take(controller, &item);
            }
        }
    }

    /// Streams the state of a cycle and its messages.
    pub fn publish(
        &mut self,
        controller: &Controller,
        messages: &[Message],
        geometry: &Geometry,
        now: Instant,
    ) {
        if self.clients.is_empty() {
            return;
        }
        let flavour = controller.config().flavour;
        let time = controller.time_s();
        let mut packages = Vec::new();
        if self.stream == Stream::Primary {
            packages.extend(messages.iter().map(|m| primary::message(m, time)));
        }
        if self.stream == Stream::Realtime {
            primary::realtime(&mut self.state, &controller.summary(), flavour, 253.0);
        } else if time >= self.next_state_s {
            self.next_state_s = time + 0.1;
            primary::robot_state(&mut self.state, &controller.summary(), flavour, geometry);
        } else {
            self.state.clear();
        }
        for (connection, _) in &mut self.clients {
            for package in &packages {
                connection.send(package, now);
            }
            if !self.state.is_empty() {
                connection.send(&self.state, now);
            }
            // Programs that only write scripts keep their connection, as on a real controller.
            connection.tend(now, None);
        }
        self.clients
            .retain(|(connection, _)| !connection.is_closed());
    }
}

/// Processes a line for the controller itself, or a program.
fn take(controller: &mut Controller, text: &str) {
    match text.trim() {
        "" => {}
        "stop program" => controller.stop_program(),
        "power on" => controller.power_on(),
        "power off" => controller.power_off(),
        "set robotmode run" => controller.release_brakes(),
        "set unlock protective stop" => {
            if controller.unlock().is_err() {
                controller.log_line("unlock refused: 5 s have not passed");
            }
        }
        _ => controller.upload(text),
    }
}

/// Cuts a stream of text into programs and single lines.
#[derive(Debug, Default)]
pub struct Collector {
    line: Vec<u8>,
    program: String,
}

/// The program or line is longer than any controller accepts.
#[derive(Debug, PartialEq, Eq)]
pub struct TooLong;

impl Collector {
    /// Takes bytes as they arrive, and returns complete texts: a program ends with `end` in column
    /// 1 and its newline.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<String>, TooLong> {
        let mut out = Vec::new();
        for byte in bytes {
            if *byte != b'\n' {
                self.line.push(*byte);
                if self.line.len() + self.program.len() > PROGRAM_BYTES_MAX {
                    return Err(TooLong);
                }
                continue;
            }
            let line = String::from_utf8_lossy(&self.line).trim_end().to_owned();
            self.line.clear();
            if self.program.is_empty() && !starts_program(&line) {
                if !line.trim().is_empty() && !line.trim_start().starts_with('#') {
                    out.push(line);
                }
                continue;
            }
            self.program.push_str(&line);
            self.program.push('\n');
            if line == "end" {
                out.push(std::mem::take(&mut self.program));
            }
        }
        Ok(out)
    }
}

fn starts_program(line: &str) -> bool {
    ["def ", "sec "].iter().any(|word| line.starts_with(word))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use tangent_urscript::Program;

    use super::*;
    use crate::rig::Rig;

    #[test]
    fn programs_and_lines_come_out_whole_however_they_are_cut() {
        let text = b"stop program\n\n# note\ndef a():\n  if True:\n    sync()\n  end\nend\nset_digital_out(1, True)\n";
        for size in [1, 7, 1000] {
            let mut collector = Collector::default();
            let mut items = Vec::new();
            for chunk in text.chunks(size) {
                items.extend(collector.push(chunk).unwrap());
            }
            assert_eq!(items.len(), 3);
            assert_eq!(items[0], "stop program");
            assert!(items[1].starts_with("def a():") && items[1].ends_with("\nend\n"));
            assert_eq!(items[2], "set_digital_out(1, True)");
        }
    }

    #[test]
    fn a_program_without_end_is_refused_in_time() {
        let mut collector = Collector::default();
        let chunk = b"def a():\n".repeat(1000);
        let mut refused = false;
        for _ in 0..200 {
            refused |= collector.push(&chunk).is_err();
        }
        assert!(refused);
    }

    proptest! {
        /// Random bytes and texts: no panic.
        #[test]
        fn any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..300), text in "\\PC{0,100}") {
            let mut rig = Rig::cb3();
            let mut collector = Collector::default();
            for item in collector.push(&bytes).unwrap() {
                rig.run(&item, 1);
            }
            let _ = Program::compile(&text, true);
        }
    }
}
