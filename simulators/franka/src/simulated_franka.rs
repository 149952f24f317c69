//! The running robot: its handle and its thread.

use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_franka::fci::PORT;
use tangent_mechanics::ModelError;
use tangent_runtime::realtime::setup_thread;
use tangent_simulated_device::Ports;

use crate::bench::BenchPlant;
use crate::config::FciConfig;
use crate::fault::FciFault;
use crate::plant::TorquePlant;
use crate::robot::FciRobot;
use crate::server::{FciTruthListener, Server, Shared, Snapshot};

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

/// A running robot. Dropping it stops it.
pub struct SimulatedFranka {
    address: SocketAddr,
    faults: Sender<FciFault>,
    snapshot: Arc<Mutex<Option<Snapshot>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
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
        let (faults, receiver) = channel();
        let snapshot = Arc::new(Mutex::new(None));
        let stop = Arc::new(AtomicBool::new(false));
        let robot = FciRobot::new(config, plant)?;
        let wait = Duration::from_secs_f64(config.answer_wait_s.clamp(0.0, 10.0));
        let shared = Shared {
            faults: receiver,
            snapshot: Arc::clone(&snapshot),
            stop: Arc::clone(&stop),
            truth,
        };
        let mut server = Server::new(robot, listener, udp, wait, shared);
        let priority = config.realtime_priority;
        let thread = std::thread::Builder::new()
            .name("simulated franka".into())
            .spawn(move || {
                if let Some(priority) = priority {
                    setup_thread("simulated robot", priority);
                }
                server.run();
            })
            .map_err(FciStartError::Thread)?;
        Ok(Self {
            address,
            faults,
            snapshot,
            stop,
            thread: Some(thread),
        })
    }

    /// Address on which the robot listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Provokes (or ends) a fault in the next cycle.
    pub fn fault(&self, fault: FciFault) {
        // A robot that has ended ignores faults.
        let _ = self.faults.send(fault);
    }

    /// A function that provokes faults, for other threads.
    pub fn faults(&self) -> impl Fn(FciFault) + Send + Sync + use<> {
        let faults = self.faults.clone();
        move |fault| {
            let _ = faults.send(fault);
        }
    }

    /// State after the last cycle; `None` before the first.
    pub fn snapshot(&self) -> Option<Snapshot> {
        self.snapshot
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Waits until `condition` holds, with one check per millisecond; false if it does not within
    /// `at_most`.
    pub fn wait_for(&self, at_most: Duration, condition: impl Fn(&Snapshot) -> bool) -> bool {
        let deadline = Instant::now() + at_most;
        loop {
            if self.snapshot().is_some_and(|s| condition(&s)) {
                return true;
            }
            if Instant::now() >= deadline {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Whether its thread has ended by itself, which it never should.
    pub fn has_ended(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Stops the robot and waits for its thread.
    pub fn stop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!(target: "simulator", "the robot's thread failed");
        }
    }
}

impl Drop for SimulatedFranka {
    fn drop(&mut self) {
        self.stop();
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
