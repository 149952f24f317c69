//! A simulated cell on loopback, and a way to speak to it.

// Each test file takes what it needs.
#![allow(dead_code)]

use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

use tangent_simulation::ServoConfig;
use tangent_simulator::arm_plant::BareArm;
use tangent_simulator::{ControllerConfig, Flavour, Ports, SimulatedCell, StartError};

pub const PATIENCE: Duration = Duration::from_secs(20);

/// A cell with a bare arm: no sensor, no surface.
pub fn start_at(
    address: IpAddr,
    ports: Ports,
    config: &ControllerConfig,
) -> Result<SimulatedCell, StartError> {
    let servo = match config.flavour {
        Flavour::Cb3 => ServoConfig::cb3(),
        Flavour::ESeries => ServoConfig::e_series(),
    };
    let arm = Box::new(BareArm::builtin("ur5", &servo).unwrap());
    SimulatedCell::start_with_plant(address, ports, config, "ur5", arm, None)
}

pub fn start(config: ControllerConfig) -> SimulatedCell {
    start_at(IpAddr::V4(Ipv4Addr::LOCALHOST), Ports::Ephemeral, &config).unwrap()
}

pub fn cb3() -> SimulatedCell {
    start(ControllerConfig::default())
}

pub fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_nodelay(true).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// The repository's folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The one with the clients, where it is installed.
pub fn python() -> PathBuf {
    if let Some(path) = std::env::var_os("TANGENT_PYTHON") {
        return path.into();
    }
    let local = root().join(".venv/bin/python3");
    if local.exists() {
        local
    } else {
        "python3".into()
    }
}
