//! Connects to a robot, repeatedly, until the service stops.

use std::fmt;
use std::time::Duration;

use crate::health::HealthReporter;
use crate::stop::Stop;
use crate::watchdog::{Beat, TURN};

/// First pause between two attempts to connect.
pub const PAUSE_MIN: Duration = Duration::from_millis(200);
/// Longest pause between two attempts to connect.
pub const PAUSE_MAX: Duration = Duration::from_secs(5);
/// Longest time that the system's resolver may take for a host name.
const RESOLVE: Duration = Duration::from_secs(60);

/// Pauses between attempts to connect: each is twice as long as the one before, up to
/// [`PAUSE_MAX`].
#[derive(Clone, Copy, Debug)]
pub struct Backoff {
    next: Duration,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { next: PAUSE_MIN }
    }
}

impl Backoff {
    /// The pause before the next attempt. `served`: the last connection brought at least one state
    /// of the robot, so the pauses start over.
    pub fn pause(&mut self, served: bool) -> Duration {
        let pause = if served { PAUSE_MIN } else { self.next };
        self.next = (pause * 2).min(PAUSE_MAX);
        pause
    }
}

/// Address of a robot, and the service that connects to it.
#[derive(Clone, Debug)]
pub struct Endpoint<'a> {
    /// Name of the service, for the watchdog.
    pub service: &'static str,
    /// Host name or address.
    pub host: &'a str,
    /// Port.
    pub port: u16,
    /// Time allowed for each attempt to connect.
    pub connect_timeout: Duration,
}

/// The loop of a robot bridge, as [`run_robot_loop`] drives it.
pub trait RobotLoop {
    /// An open connection.
    type Connection;
    /// Why a connection cannot be opened, or has ended.
    type Error: fmt::Display;

    /// Opens a connection to the robot.
    ///
    /// # Errors
    /// The host does not exist or does not answer.
    fn connect(&self) -> Result<Self::Connection, Self::Error>;

    /// Serves one connection until the orderly end is done. `reconnects` is the number of earlier
    /// connections. Beats once per turn.
    ///
    /// # Errors
    /// The connection ended before that; the error says why.
    fn serve(
        &mut self,
        connection: Self::Connection,
        reconnects: u64,
        beat: &Beat,
    ) -> Result<(), Self::Error>;

    /// Discards the state of the connection. Called after each attempt.
    fn close(&mut self);

    /// Number of robot packets since the start.
    fn cycle(&self) -> u64;
}

/// Connects, serves, and connects again after a pause, until `stop`.
///
/// A failure is reported as a fault of the service. The log gets one warning for it, and not
/// another one while the same failure repeats.
pub fn run_robot_loop(
    robot: &mut impl RobotLoop,
    endpoint: &Endpoint<'_>,
    health: &HealthReporter,
    stop: &Stop,
) {
    let shown = health.gauge("reconnects");
    let beat = Beat::new(endpoint.service);
    let mut backoff = Backoff::default();
    let mut connections = 0u64;
    let mut last = String::new();
    while !stop.is_stopped() {
        let cycles = robot.cycle();
        beat.within(endpoint.connect_timeout + RESOLVE);
        let ended = robot.connect().and_then(|connection| {
            let reconnects = connections;
            connections += 1;
            shown.set(reconnects as f64);
            robot.serve(connection, reconnects, &beat)
        });
        robot.close();
        if let Err(error) = ended {
            let text = format!("{}:{}: {error}", endpoint.host, endpoint.port);
            health.fault(format_args!("{text}"));
            if text == last {
                tracing::debug!("{text}");
            } else {
                tracing::warn!("{text}; trying again");
            }
            last = text;
        }
        let served = robot.cycle() > cycles;
        if served {
            last.clear();
        }
        let pause = backoff.pause(served);
        beat.within(pause + TURN);
        if stop.wait(pause) {
            break;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::Bus;

    /// A robot that refuses the first attempt, sends one state on the second and closes, and stops
    /// the service on the third.
    struct Robot {
        connections: std::cell::Cell<u64>,
        reconnects: Vec<u64>,
        closed: u64,
        cycle: u64,
        stop: Stop,
    }

    impl RobotLoop for Robot {
        type Connection = u64;
        type Error = String;

        fn connect(&self) -> Result<u64, String> {
            let n = self.connections.get() + 1;
            self.connections.set(n);
            if n == 1 { Err("refused".into()) } else { Ok(n) }
        }

        fn serve(&mut self, n: u64, reconnects: u64, _: &Beat) -> Result<(), String> {
            self.reconnects.push(reconnects);
            if n == 3 {
                self.stop.trigger();
                return Ok(());
            }
            self.cycle += 1;
            Err("closed".into())
        }

        fn close(&mut self) {
            self.closed += 1;
        }

        fn cycle(&self) -> u64 {
            self.cycle
        }
    }

    #[test]
    fn it_connects_again_until_stopped_and_counts_what_was_served() {
        let stop = Stop::new();
        let bus = Bus::in_process("test");
        let health = HealthReporter::start(&bus, "robot").unwrap();
        let mut robot = Robot {
            connections: 0.into(),
            reconnects: Vec::new(),
            closed: 0,
            cycle: 0,
            stop: stop.clone(),
        };
        let endpoint = Endpoint {
            service: "robot",
            host: "localhost",
            port: 1,
            connect_timeout: Duration::from_millis(1),
        };
        run_robot_loop(&mut robot, &endpoint, &health, &stop);
        assert_eq!(robot.connections.get(), 3);
        assert_eq!(robot.closed, 3);
        // The refused attempt does not count as a connection.
        assert_eq!(robot.reconnects, [0, 1]);
    }

    #[test]
    fn pauses_double_up_to_the_longest_and_start_over_after_a_state() {
        let mut backoff = Backoff::default();
        let pauses: Vec<_> = (0..7).map(|_| backoff.pause(false).as_millis()).collect();
        assert_eq!(pauses, [200, 400, 800, 1600, 3200, 5000, 5000]);
        assert_eq!(backoff.pause(true), PAUSE_MIN);
        assert_eq!(backoff.pause(false), 2 * PAUSE_MIN);
    }
}
