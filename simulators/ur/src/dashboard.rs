//! The dashboard server: one line in, one line out.

use std::net::TcpListener;
use std::time::{Duration, Instant};

use crate::config::Flavour;
use crate::connection::{Connection, accept};
use crate::controller::Controller;

const GREETING: &str = "Connected: Universal Robots Dashboard Server\n";
/// Longest line taken, bytes.
const LINE_BYTES_MAX: usize = 4096;
const LOCKED: &str = "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking";

/// All dashboard clients.
#[derive(Debug)]
pub struct DashboardServer {
    listener: TcpListener,
    clients: Vec<(Connection, Vec<u8>)>,
    state: Dashboard,
}

/// State of the dashboard.
#[derive(Debug, Default)]
pub struct Dashboard {
    loaded: Option<String>,
}

impl DashboardServer {
    /// Creates a server for a non-blocking listener.
    pub fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            clients: Vec::new(),
            state: Dashboard::default(),
        }
    }

    /// Disconnects all clients.
    pub fn disconnect_all(&mut self) {
        self.clients.clear();
    }

    /// Accepts new clients and answers all lines that have arrived.
    pub fn poll(&mut self, controller: &mut Controller, now: Instant) {
        for mut connection in accept(&self.listener, self.clients.len()) {
            connection.send(GREETING.as_bytes(), now);
            self.clients.push((connection, Vec::new()));
        }
        for (connection, buffer) in &mut self.clients {
            connection.read(buffer);
            while let Some(end) = buffer.iter().position(|b| *b == b'\n') {
                let line: Vec<u8> = buffer.drain(..=end).collect();
                let line = String::from_utf8_lossy(&line);
                let mut answer = self.state.answer(line.trim(), controller);
                answer.push('\n');
                connection.send(answer.as_bytes(), now);
                if matches!(line.trim(), "quit" | "shutdown") {
                    connection.close();
                }
            }
            if buffer.len() > LINE_BYTES_MAX {
                connection.close();
            }
            connection.tend(now, Some(Duration::from_secs(2)));
        }
        self.clients
            .retain(|(connection, _)| !connection.is_closed());
    }
}

impl Dashboard {
    /// The answer to one line, without its newline.
    pub fn answer(&mut self, line: &str, controller: &mut Controller) -> String {
        let config = controller.config();
        let e_series = config.flavour == Flavour::ESeries;
        let acts = [
            "power", "brake", "load", "play", "stop", "pause", "unlock", "restart",
        ]
        .iter()
        .any(|word| line.starts_with(word));
        if e_series && acts && !config.remote_control {
            return "Command is not allowed due to safety reasons. Robot is not in remote control mode."
                .to_owned();
        }
        let program = self.loaded.as_deref();
        let answer: &str = match line {
            "robotmode" => return format!("Robotmode: {}", controller.robot_mode().name()),
            "safetymode" => {
                return format!("Safetymode: {}", controller.safety_on_dashboard().name());
            }
            "safetystatus" if e_series => {
                return format!("Safetystatus: {}", controller.safety_on_dashboard().name());
            }
            "power on" => {
                controller.power_on();
                "Powering on"
            }
            "power off" => {
                controller.power_off();
                "Powering off"
            }
            "brake release" => {
                controller.release_brakes();
                "Brake releasing"
            }
            "play" => {
                if controller.resume() {
                    "Starting program"
                } else {
                    "Failed to execute: play"
                }
            }
            // Without a program, too: clients make sure of it before they start theirs.
            "stop" => {
                controller.stop_program();
                "Stopped"
            }
            "pause" => {
                if controller.is_playing() {
                    controller.pause();
                    "Pausing program"
                } else {
                    "Failed to execute: pause"
                }
            }
            "running" => return format!("Program running: {}", controller.is_playing()),
            // Does not show programs that came over a port, as on a real controller.
            "programState" => return format!("STOPPED {}", program.unwrap_or("<unnamed>")),
            "isProgramSaved" => return format!("true {}", program.unwrap_or("<unnamed>")),
            "get loaded program" => match program {
                Some(name) => return format!("Loaded program: /programs/{name}"),
                None => "No program loaded",
            },
            "unlock protective stop" => match controller.unlock() {
                Ok(()) => "Protective stop releasing",
                Err(_) => LOCKED,
            },
            "close safety popup" => "closing safety popup",
            "close popup" => {
                controller.close_popup();
                "closing popup"
            }
            "restart safety" => {
                controller.restart_safety();
                "Restarting safety"
            }
            "PolyscopeVersion" => config.flavour.polyscope_version(),
            "version" if e_series => return config.flavour.version().to_string(),
            "is in remote control" if e_series => {
                return config.remote_control.to_string();
            }
            "get serial number" => return config.serial_number.clone(),
            "get robot model" => return controller.robot_model().to_owned(),
            "get operational mode" if e_series => "NONE",
            "shutdown" => "Shutting down",
            "quit" => "Disconnected",
            _ => return self.with_argument(line, controller),
        };
        answer.to_owned()
    }

    fn with_argument(&mut self, line: &str, controller: &mut Controller) -> String {
        if let Some(name) = line.strip_prefix("load ") {
            // There is no disk; any program name is accepted.
            if name.ends_with(".urp") {
                self.loaded = Some(name.to_owned());
                return format!("Loading program: {name}");
            }
            return format!("File not found: {name}");
        }
        if let Some(text) = line.strip_prefix("addToLog ") {
            controller.log_line(text);
            return "Added log message".to_owned();
        }
        if line.starts_with("popup ") {
            return "showing popup".to_owned();
        }
        format!("could not understand: '{line}'")
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::Dashboard;
    use crate::config::ControllerConfig;
    use crate::rig::Rig;

    proptest! {
        /// Random lines: no panic, each is answered, and so is the next known command.
        #[test]
        fn any_lines(lines in prop::collection::vec("\\PC{0,40}", 0..10)) {
            let mut rig = Rig::new(ControllerConfig::default());
            let mut dashboard = Dashboard::default();
            for line in &lines {
                prop_assert!(!dashboard.answer(line, &mut rig.controller).is_empty());
            }
            prop_assert!(dashboard.answer("robotmode", &mut rig.controller).starts_with("Robotmode: "));
        }
    }
}
