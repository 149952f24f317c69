//! A simulated controller with a bare arm on loopback, and connections to it.

// Each test file uses a part of this module.
#![allow(dead_code)]

use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::time::Duration;

use tangent_simulated_device::Ports;
use tangent_simulated_ur::plant::BareArm;
use tangent_simulated_ur::{ControllerConfig, Flavour, Listeners, Place, SimulatedUr, StartError};
use tangent_simulation::ServoConfig;

pub const PATIENCE: Duration = Duration::from_secs(20);

/// A controller with a bare arm: no sensor, no surface.
pub fn start_at(
    address: IpAddr,
    ports: Ports,
    config: &ControllerConfig,
) -> Result<SimulatedUr, StartError> {
    start_model(address, ports, config, "ur5")
}

/// A controller with a bare arm of this built-in model.
pub fn start_model(
    address: IpAddr,
    ports: Ports,
    config: &ControllerConfig,
    model: &str,
) -> Result<SimulatedUr, StartError> {
    let servo = match config.flavour {
        Flavour::Cb3 => ServoConfig::cb3(),
        Flavour::ESeries => ServoConfig::e_series(),
    };
    let place = Place {
        address,
        ports,
        ..Place::default()
    };
    let arm = Box::new(BareArm::builtin(model, &servo).unwrap());
    SimulatedUr::start(place, config, model, arm, Listeners::default())
}

pub fn start(config: ControllerConfig) -> SimulatedUr {
    start_at(IpAddr::V4(Ipv4Addr::LOCALHOST), Ports::Ephemeral, &config).unwrap()
}

pub fn cb3() -> SimulatedUr {
    start(ControllerConfig::default())
}

pub fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_nodelay(true).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// A package of RTDE.
pub fn rtde_request(kind: u8, payload: &[u8]) -> Vec<u8> {
    let length = u16::try_from(payload.len() + 3).unwrap();
    [&length.to_be_bytes(), &[kind][..], payload].concat()
}

/// Kind and payload of the next package of RTDE.
pub fn rtde_answer(stream: &mut TcpStream) -> (u8, Vec<u8>) {
    let mut head = [0; 3];
    stream.read_exact(&mut head).unwrap();
    let mut payload = vec![0; usize::from(u16::from_be_bytes([head[0], head[1]])) - 3];
    stream.read_exact(&mut payload).unwrap();
    (head[2], payload)
}
