//! Prepares the robot by operations that may wait: the script port (sending the program, reading
//! messages about it) and the dashboard (power, model, remote mode). It has its own thread, so that
//! the loop is never delayed.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tangent_runtime::Stop;

use crate::dashboard::{Dashboard, DashboardError, ur_size};
use crate::primary::{CODE_READ_ONLY, PrimaryMessage, PrimaryReader};
use crate::program::PROGRAM_NAME;
use crate::settings::Config;
use crate::shared::{Shared, Upload};

/// Longest time for one check of the socket, and longest delay of an upload.
const LOOK: Duration = Duration::from_millis(20);
/// Pause between attempts to reach the script port.
const RETRY: Duration = Duration::from_secs(1);
/// Time allowed for power and brakes; afterwards, an operator has to act.
const POWER_UP: Duration = Duration::from_secs(30);
/// Timeout of the dashboard.
const DASHBOARD: Duration = Duration::from_secs(3);

/// First address of a host and port.
pub(crate) fn resolve(host: &str, port: u16) -> std::io::Result<SocketAddr> {
    (host, port)
        .to_socket_addrs()?
        .next()
        .ok_or_else(|| std::io::Error::new(ErrorKind::NotFound, format!("{host} has no address")))
}

/// A dashboard connection of the cell's robot.
pub(crate) fn dashboard(config: &Config) -> Result<Dashboard, DashboardError> {
    let unresolved = SocketAddr::from(([0, 0, 0, 0], config.dashboard_port));
    let address = resolve(&config.host, config.dashboard_port).map_err(|error| {
        DashboardError::Connection {
            address: unresolved,
            reason: error.to_string(),
        }
    })?;
    Dashboard::connect(address, DASHBOARD)
}

pub(crate) struct RobotSetup<'a> {
    config: &'a Config,
    shared: &'a Shared,
    stop: &'a Stop,
    connection: Option<(TcpStream, PrimaryReader)>,
    next_attempt: Instant,
    links: u64,
    uploads: u32,
}

impl<'a> RobotSetup<'a> {
    pub fn new(config: &'a Config, shared: &'a Shared, stop: &'a Stop) -> Self {
        Self {
            config,
            shared,
            stop,
            connection: None,
            next_attempt: Instant::now(),
            links: 0,
            uploads: 0,
        }
    }

    /// Runs until the loop has ended.
    pub fn run(mut self) {
        while !self.shared.has_ended() {
            let links = self.shared.links.load(Ordering::Acquire);
            if links != self.links {
                self.links = links;
                self.uploads = 0;
                self.meet();
                if self.config.power_on {
                    self.power_up();
                }
            }
            if self.shared.power_on_asked.swap(false, Ordering::AcqRel) {
                self.power_up();
            }
            if let Some(upload) = self.shared.uploads.pop() {
                self.upload(upload);
            } else if self.links == 0 {
                std::thread::park_timeout(Duration::from_millis(100));
            } else {
                self.listen();
            }
        }
    }

    /// Checks that the robot that was reached is the cell's.
    fn meet(&mut self) {
        let asked = dashboard(self.config).and_then(|mut dashboard| {
            Ok((
                dashboard.polyscope_version()?,
                dashboard.robot_model()?,
                dashboard.is_in_remote_control()?,
            ))
        });
        match asked {
            Ok((version, model, remote)) => {
                let version = version.as_deref().unwrap_or("of unknown version");
                let said = model
                    .as_deref()
                    .unwrap_or("a robot that does not report its model");
                tracing::info!("robot: {said}, PolyScope {version}");
                let expected = ur_size(&self.config.bridge.model);
                let found = model.as_deref().and_then(ur_size);
                let wrong = matches!((expected, found), (Some(a), Some(b)) if a != b);
                self.shared.wrong_model.store(wrong, Ordering::Release);
                if wrong {
                    tracing::error!(
                        "the robot is a {said}, but [robot] model is \"{}\": the arm will not move",
                        self.config.bridge.model
                    );
                }
                if remote == Some(false) {
                    tracing::warn!(
                        "the robot is in local control: switch the pendant to Remote Control"
                    );
                }
            }
            Err(error) => {
                self.shared.wrong_model.store(false, Ordering::Release);
                tracing::warn!("{error}; continuing without it");
            }
        }
    }

    /// Powers on and releases the brakes, as far as the robot allows.
    fn power_up(&mut self) {
        // The script port is not read meanwhile, and a controller drops a client that does not
        // read.
        self.connection = None;
        if let Err(error) = self.try_power_up() {
            tracing::warn!("powering on: {error}");
        }
    }

    fn try_power_up(&self) -> Result<(), DashboardError> {
        let mut dashboard = dashboard(self.config)?;
        let deadline = Instant::now() + POWER_UP;
        let mut asked = (false, false);
        while Instant::now() < deadline && !self.stop.is_stopped() {
            match dashboard.robot_mode()?.as_str() {
                "RUNNING" => {
                    if asked.0 || asked.1 {
                        tracing::info!("the arm is powered and its brakes are open");
                    }
                    return Ok(());
                }
                "POWER_OFF" if !asked.0 => {
                    dashboard.power_on()?;
                    asked.0 = true;
                }
                "IDLE" | "POWER_ON" if !asked.1 => {
                    dashboard.brake_release()?;
                    asked.1 = true;
                }
                _ => {
                    self.stop.wait(Duration::from_millis(100));
                }
            }
        }
        tracing::warn!("the arm is not running yet: check the pendant");
        Ok(())
    }

    fn connect(&mut self) {
        if self.connection.is_some() || Instant::now() < self.next_attempt {
            return;
        }
        let made = resolve(&self.config.host, self.config.script_port).and_then(|address| {
            let stream = TcpStream::connect_timeout(&address, self.config.connect_timeout)?;
            stream.set_nodelay(true)?;
            stream.set_read_timeout(Some(LOOK))?;
            stream.set_write_timeout(Some(self.config.connect_timeout))?;
            Ok(stream)
        });
        match made {
            Ok(stream) => self.connection = Some((stream, PrimaryReader::default())),
            Err(error) => {
                tracing::warn!(
                    "script port {}:{}: {error}",
                    self.config.host,
                    self.config.script_port
                );
                self.next_attempt = Instant::now() + RETRY;
            }
        }
    }

    fn upload(&mut self, upload: Upload) {
        // A connection made in local control stays read-only, so every further attempt gets a fresh
        // one.
        if self.uploads > 0 {
            self.connection = None;
        }
        self.uploads += 1;
        self.next_attempt = Instant::now();
        self.connect();
        let program = match self.config.program(upload.session, upload.series).render() {
            Ok(program) => program,
            Err(error) => {
                tracing::error!("{error}");
                return;
            }
        };
        let Some((stream, _)) = &mut self.connection else {
            return;
        };
        match stream.write_all(program.as_bytes()) {
            Ok(()) => tracing::info!("sent the robot program, {} bytes", program.len()),
            Err(error) => {
                tracing::warn!("sending the robot program: {error}");
                self.connection = None;
            }
        }
    }

    /// Reads the controller's messages about programs and errors.
    fn listen(&mut self) {
        self.connect();
        let Some((stream, reader)) = &mut self.connection else {
            std::thread::park_timeout(LOOK);
            return;
        };
        let mut bytes = [0; 4096];
        let broken = match stream.read(&mut bytes) {
            Ok(0) => Some("closed by the robot".to_owned()),
            Ok(n) => match reader.push(&bytes[..n]) {
                Ok(messages) => messages.iter().find_map(log),
                Err(error) => Some(error.to_string()),
            },
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) =>
            {
                None
            }
            Err(error) => Some(error.to_string()),
        };
        if let Some(reason) = broken {
            tracing::debug!("script port: {reason}");
            self.connection = None;
            self.next_attempt = Instant::now() + RETRY;
        }
    }
}

/// Logs the message; returns the reason if the connection is no longer useful.
fn log(message: &PrimaryMessage) -> Option<String> {
    match message {
        PrimaryMessage::Text(text) => tracing::info!("robot: {text}"),
        PrimaryMessage::Error {
            code,
            argument,
            text,
        } if *code == CODE_READ_ONLY => {
            tracing::warn!(
                "robot: C{code}A{argument} {text}: it accepts no programs from the network, switch it to Remote Control"
            );
            return Some("read-only".to_owned());
        }
        PrimaryMessage::Error {
            code,
            argument,
            text,
        } => {
            tracing::warn!("robot: C{code}A{argument} {text}");
        }
        PrimaryMessage::Key { title, text } if text == PROGRAM_NAME => {
            tracing::debug!("robot: {title} {text}");
        }
        PrimaryMessage::Key { title, text } => tracing::info!("robot: {title} {text}"),
        PrimaryMessage::RuntimeException { line, column, text } => {
            tracing::error!("robot program failed at line {line}, column {column}: {text}");
        }
        PrimaryMessage::Safety { code, argument } => {
            tracing::warn!("robot: safety message C{code}A{argument}");
        }
    }
    None
}
