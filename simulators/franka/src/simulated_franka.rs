//! Handle of the running robot: starting it, and its address.

use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, UdpSocket};
use std::ops::Deref;
use std::time::Duration;

use tangent_franka::fci::PORT;
use tangent_mechanics::ModelError;
use tangent_simulated_device::{DeviceThread, Ports};

use crate::bench::BenchPlant;
use crate::config::FciConfig;
use crate::fault::FciFault;
use crate::plant::TorquePlant;
use crate::robot::FciRobot;
use crate::server::{FciTruthListener, Server, Snapshot};

/// Reasons why a robot cannot start.
#[derive(Debug, thiserror::Error)]
pub enum FciStartError {
    /// The model is not valid.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A port is not available.
    #[error(
        "cannot listen on {address} for FCI: {reason}; another simulator may hold it: use another address or port offset"
    )]
    Port {
        /// Address and port.
        address: String,
        /// Error of the operating system.
        reason: io::Error,
    },
    /// The offset leads beyond the last port.
    #[error("port offset {offset} leads past port 65535 for FCI; at most 64198 is allowed")]
    Offset {
        /// Configured offset.
        offset: u16,
    },
    /// The thread could not be started.
    #[error("cannot start the robot's thread: {0}")]
    Thread(io::Error),
}

/// A running robot: the [`DeviceThread`] of its faults and snapshots, and its address. Dropping it
/// stops it.
pub struct SimulatedFranka {
    address: SocketAddr,
    thread: DeviceThread<FciFault, Snapshot>,
}

impl std::fmt::Debug for SimulatedFranka {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SimulatedFranka")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

impl SimulatedFranka {
    /// Starts a robot with the arm and plane of `config`.
    ///
    /// # Errors
    /// A port is taken.
    pub fn start(config: &FciConfig) -> Result<Self, FciStartError> {
        let plant = BenchPlant::new(&config.plant)?;
        Self::start_with(config, Box::new(plant), None)
    }

    /// Starts a robot around any plant; `truth` is called with the state of its contact.
    ///
    /// # Errors
    /// A port is taken.
    pub fn start_with(
        config: &FciConfig,
        plant: Box<dyn TorquePlant>,
        truth: Option<FciTruthListener>,
    ) -> Result<Self, FciStartError> {
        let (listener, udp) = bind(config.address, config.ports)?;
        let refused = |reason| FciStartError::Port {
            address: config.address.to_string(),
            reason,
        };
        let address = listener.local_addr().map_err(refused)?;
        listener.set_nonblocking(true).map_err(refused)?;
        udp.set_nonblocking(true).map_err(refused)?;
        let robot = FciRobot::new(config, plant)?;
        let wait = Duration::from_secs_f64(config.answer_wait_s.clamp(0.0, 10.0));
        let thread =
            DeviceThread::start("simulated franka", config.realtime_priority, move |link| {
                Server::new(robot, listener, udp, wait, link, truth).run();
            })
            .map_err(FciStartError::Thread)?;
        Ok(Self { address, thread })
    }

    /// Address on which the robot listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Deref for SimulatedFranka {
    type Target = DeviceThread<FciFault, Snapshot>;

    fn deref(&self) -> &Self::Target {
        &self.thread
    }
}

/// Binds TCP and UDP on the same port.
fn bind(address: IpAddr, ports: Ports) -> Result<(TcpListener, UdpSocket), FciStartError> {
    let offset = ports.offset();
    let port = ports.of(PORT).ok_or(FciStartError::Offset { offset })?;
    let wanted = SocketAddr::new(address, port);
    let refused = |reason| FciStartError::Port {
        address: wanted.to_string(),
        reason,
    };
    let mut attempts = 0;
    loop {
        attempts += 1;
        let listener = TcpListener::bind(wanted).map_err(refused)?;
        let same = listener.local_addr().map_err(refused)?;
        match UdpSocket::bind(same) {
            Ok(udp) => return Ok((listener, udp)),
            // The UDP port of this number is in use; if any port may be used, another one is tried.
            Err(_) if port == 0 && attempts < 20 => {}
            Err(reason) => return Err(refused(reason)),
        }
    }
}
