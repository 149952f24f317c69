//! Client of the dashboard server: power, brakes, unlocking, remote mode, model. Each command and
//! each answer is one line.
//!
//! It is for operators and never used for safety: its answers lag behind RTDE by more than half a
//! second, and it does not report programs that were sent over a port.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// Longest accepted line, bytes.
const LINE_MAX: usize = 4096;

/// Errors of the dashboard connection.
#[derive(Debug, thiserror::Error)]
pub enum DashboardError {
    /// The server cannot be reached, or the connection broke.
    #[error("dashboard server at {address}: {reason}; is the robot on, and the port open?")]
    Connection {
        /// Host and port.
        address: SocketAddr,
        /// The system's reason.
        reason: String,
    },
    /// No answer arrived in time.
    #[error("dashboard server did not answer `{command}` within {after_s} s")]
    NoAnswer {
        /// Command that was sent.
        command: String,
        /// Time waited, s.
        after_s: f64,
    },
    /// The server refused the command.
    #[error("dashboard server refused `{command}`: {reply}{hint}")]
    Refused {
        /// Command that was sent.
        command: String,
        /// Text of the answer.
        reply: String,
        /// What to do, or empty.
        hint: &'static str,
    },
    /// A line without an end.
    #[error("dashboard server sent a line of more than {LINE_MAX} bytes")]
    LineTooLong,
}

/// Collects bytes into lines of bounded length.
#[derive(Debug, Default)]
pub struct Lines {
    bytes: Vec<u8>,
}

impl Lines {
    /// Appends received bytes.
    ///
    /// # Errors
    /// [`DashboardError::LineTooLong`] if a line does not end within the longest accepted length.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), DashboardError> {
        if self.bytes.len() + bytes.len() > 2 * LINE_MAX {
            return Err(DashboardError::LineTooLong);
        }
        self.bytes.extend_from_slice(bytes);
        Ok(())
    }

    /// The next whole line, without its end.
    pub fn next_line(&mut self) -> Option<String> {
        let end = self.bytes.iter().position(|b| *b == b'\n')?;
        let line: Vec<u8> = self.bytes.drain(..=end).collect();
        Some(String::from_utf8_lossy(&line).trim().to_owned())
    }
}

/// Version in an answer to `PolyscopeVersion`: `5.11.0.108249` in `URSoftware 5.11.0.108249 (Feb 03
/// 2021)`.
pub fn polyscope_version(reply: &str) -> Option<&str> {
    let (_, rest) = reply.split_once(' ')?;
    let version = rest.split(" (").next()?.trim();
    version
        .starts_with(|c: char| c.is_ascii_digit())
        .then_some(version)
}

/// Size of the arm as a number, from the name of a model or of a robot: 5 for `UR5`, `ur5e` and
/// `UR5e`; `None` for other names. A UR7e is 5 and a UR12e 10: these arms have the geometry of a
/// UR5e and a UR10e, and their controllers name those.
pub fn ur_size(model: &str) -> Option<u32> {
    ur_number(model).map(|number| match number {
        7 => 5,
        12 => 10,
        other => other,
    })
}

/// The number in the name of a model or of a robot: 7 for `ur7e`; `None` for other names.
pub(crate) fn ur_number(model: &str) -> Option<u32> {
    let rest = model.trim().to_ascii_lowercase();
    let rest = rest.strip_prefix("ur")?;
    let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok()
}

/// One connection to the dashboard server.
#[derive(Debug)]
pub struct Dashboard {
    stream: TcpStream,
    address: SocketAddr,
    lines: Lines,
    timeout: Duration,
}

impl Dashboard {
    /// Connects and reads the greeting.
    ///
    /// # Errors
    /// The server cannot be reached, or sends no greeting within `timeout`.
    pub fn connect(address: SocketAddr, timeout: Duration) -> Result<Self, DashboardError> {
        let failed = |error: std::io::Error| DashboardError::Connection {
            address,
            reason: error.to_string(),
        };
        let stream = TcpStream::connect_timeout(&address, timeout).map_err(failed)?;
        stream.set_nodelay(true).map_err(failed)?;
        stream.set_write_timeout(Some(timeout)).map_err(failed)?;
        let mut dashboard = Self {
            stream,
            address,
            lines: Lines::default(),
            timeout,
        };
        dashboard.line("connect")?;
        Ok(dashboard)
    }

    /// Sends one command and returns the answer, one line.
    ///
    /// # Errors
    /// The connection broke, or no answer arrived in time.
    pub fn ask(&mut self, command: &str) -> Result<String, DashboardError> {
        let line = format!("{command}\n");
        self.stream
            .write_all(line.as_bytes())
            .map_err(|error| self.broken(&error))?;
        self.line(command)
    }

    /// Switches the arm's power on. The brakes stay closed.
    ///
    /// # Errors
    /// The connection broke, no answer arrived in time, or the server refused.
    pub fn power_on(&mut self) -> Result<String, DashboardError> {
        self.expect("power on", "Powering on")
    }

    /// Switches the arm's power off; the brakes close.
    ///
    /// # Errors
    /// The connection broke, no answer arrived in time, or the server refused.
    pub fn power_off(&mut self) -> Result<String, DashboardError> {
        self.expect("power off", "Powering off")
    }

    /// Opens the brakes of a powered arm.
    ///
    /// # Errors
    /// The connection broke, no answer arrived in time, or the server refused.
    pub fn brake_release(&mut self) -> Result<String, DashboardError> {
        self.expect("brake release", "Brake releasing")
    }

    /// Closes the safety pop-up and leaves a protective stop. The controller refuses in the first 5
    /// s after the stop.
    ///
    /// # Errors
    /// The connection broke, no answer arrived in time, or the server refused.
    pub fn unlock_protective_stop(&mut self) -> Result<String, DashboardError> {
        self.ask("close safety popup")?;
        self.expect("unlock protective stop", "Protective stop releasing")
    }

    /// Mode of the robot: `RUNNING`, `POWER_OFF`, `IDLE` …
    ///
    /// # Errors
    /// The connection broke, or no valid answer arrived in time.
    pub fn robot_mode(&mut self) -> Result<String, DashboardError> {
        let reply = self.expect("robotmode", "Robotmode: ")?;
        Ok(reply["Robotmode: ".len()..].to_owned())
    }

    /// Whether the robot is in remote control and accepts scripts; `None` on robots without that
    /// mode (CB3).
    ///
    /// # Errors
    /// The connection broke, or no answer arrived in time.
    pub fn is_in_remote_control(&mut self) -> Result<Option<bool>, DashboardError> {
        Ok(match self.ask("is in remote control")?.as_str() {
            "true" => Some(true),
            "false" => Some(false),
            _ => None,
        })
    }

    /// Model of the robot, for example `UR5`; `None` if the software is too old to report it.
    ///
    /// # Errors
    /// The connection broke, or no answer arrived in time.
    pub fn robot_model(&mut self) -> Result<Option<String>, DashboardError> {
        let reply = self.ask("get robot model")?;
        Ok(ur_size(&reply).map(|_| reply))
    }

    /// Version of the software; `None` if the answer contains none.
    ///
    /// # Errors
    /// The connection broke, or no answer arrived in time.
    pub fn polyscope_version(&mut self) -> Result<Option<String>, DashboardError> {
        let reply = self.ask("PolyscopeVersion")?;
        Ok(polyscope_version(&reply).map(str::to_owned))
    }

    fn expect(&mut self, command: &str, good: &str) -> Result<String, DashboardError> {
        let reply = self.ask(command)?;
        if reply.starts_with(good) {
            Ok(reply)
        } else {
            let hint = if reply.to_ascii_lowercase().contains("remote control") {
                " (switch the pendant to Remote Control)"
            } else {
                ""
            };
            Err(DashboardError::Refused {
                command: command.to_owned(),
                reply,
                hint,
            })
        }
    }

    fn line(&mut self, command: &str) -> Result<String, DashboardError> {
        let deadline = Instant::now() + self.timeout;
        loop {
            if let Some(line) = self.lines.next_line() {
                return Ok(line);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(DashboardError::NoAnswer {
                    command: command.to_owned(),
                    after_s: self.timeout.as_secs_f64(),
                });
            }
            let mut bytes = [0; 512];
            let read = self
                .stream
                .set_read_timeout(Some(left))
                .and_then(|()| self.stream.read(&mut bytes));
            match read {
                Ok(0) => {
                    return Err(DashboardError::Connection {
                        address: self.address,
                        reason: "closed by the robot".into(),
                    });
                }
                Ok(n) => self.lines.push(&bytes[..n])?,
                Err(error)
                    if matches!(
                        error.kind(),
                        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                    ) => {}
                Err(error) => return Err(self.broken(&error)),
            }
        }
    }

    fn broken(&self, error: &std::io::Error) -> DashboardError {
        DashboardError::Connection {
            address: self.address,
            reason: error.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::{BufRead, BufReader};
    use std::net::TcpListener;

    /// A dashboard server with these answers. It sends them in pieces, as a network may deliver
    /// them.
    fn server(answers: &'static [(&str, &str)]) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream
                .write_all(b"Connected: Universal Robots Dash")
                .unwrap();
            stream.write_all(b"board Server\n").unwrap();
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            let mut line = String::new();
            while reader.read_line(&mut line).unwrap_or(0) > 0 {
                let answer = answers.iter().find(|(c, _)| *c == line.trim());
                match answer {
                    Some((_, "")) => {}
                    Some((_, answer)) => {
                        stream.write_all(format!("{answer}\n").as_bytes()).unwrap()
                    }
                    None => stream.write_all(b"could not understand\n").unwrap(),
                }
                line.clear();
            }
        });
        address
    }

    #[test]
    fn the_usual_exchange() {
        let address = server(&[
            ("power on", "Powering on"),
            ("brake release", "Brake releasing"),
            ("robotmode", "Robotmode: IDLE"),
            ("close safety popup", "closing safety popup"),
            (
                "unlock protective stop",
                "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking",
            ),
            ("is in remote control", "false"),
            ("get robot model", "UR5"),
            ("PolyscopeVersion", "URSoftware 5.11.0.108249 (Feb 03 2021)"),
            (
                "power off",
                "Command is not allowed due to safety reasons: not in remote control",
            ),
        ]);
        let mut dashboard = Dashboard::connect(address, Duration::from_secs(10)).unwrap();
        dashboard.power_on().unwrap();
        dashboard.brake_release().unwrap();
        assert_eq!(dashboard.robot_mode().unwrap(), "IDLE");
        let text = dashboard.unlock_protective_stop().unwrap_err().to_string();
        assert!(text.contains("until 5s after occurrence"), "{text}");
        assert_eq!(dashboard.is_in_remote_control().unwrap(), Some(false));
        assert_eq!(dashboard.robot_model().unwrap().as_deref(), Some("UR5"));
        assert_eq!(
            dashboard.polyscope_version().unwrap().as_deref(),
            Some("5.11.0.108249")
        );
        let text = dashboard.power_off().unwrap_err().to_string();
        assert!(
            text.ends_with("(switch the pendant to Remote Control)"),
            "{text}"
        );
    }

    #[test]
    fn an_old_robot_reports_less() {
        let address = server(&[("PolyscopeVersion", "3.15.8")]);
        let mut dashboard = Dashboard::connect(address, Duration::from_secs(10)).unwrap();
        assert_eq!(dashboard.is_in_remote_control().unwrap(), None);
        assert_eq!(dashboard.robot_model().unwrap(), None);
        assert_eq!(dashboard.polyscope_version().unwrap(), None);
    }

    #[test]
    fn silence_has_an_end() {
        let address = server(&[("robotmode", "")]);
        let mut dashboard = Dashboard::connect(address, Duration::from_secs(10)).unwrap();
        dashboard.timeout = Duration::from_millis(20);
        let error = dashboard.robot_mode().unwrap_err();
        assert!(matches!(error, DashboardError::NoAnswer { .. }), "{error}");
    }

    #[test]
    fn models_are_compared_by_size() {
        for (name, size) in [
            ("UR5", Some(5)),
            ("ur5e", Some(5)),
            ("UR3", Some(3)),
            ("ur3e", Some(3)),
            ("ur10", Some(10)),
            ("UR10e", Some(10)),
            ("ur7e", Some(5)),
            ("ur12e", Some(10)),
            ("ur15", Some(15)),
            ("UR16", Some(16)),
            ("ur16e", Some(16)),
            ("UR20", Some(20)),
            ("ur30", Some(30)),
            ("UR", None),
            ("could not understand: 'get robot model'", None),
        ] {
            assert_eq!(ur_size(name), size, "{name}");
        }
    }

    proptest! {
        #[test]
        fn whatever_comes_lines_stay_bounded(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..3000), 0..20)) {
            let mut lines = Lines::default();
            for chunk in &chunks {
                if lines.push(chunk).is_err() {
                    break;
                }
                while let Some(line) = lines.next_line() {
                    polyscope_version(&line);
                    ur_size(&line);
                }
                prop_assert!(lines.bytes.len() <= 2 * LINE_MAX);
            }
        }
    }
}
