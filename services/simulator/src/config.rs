//! Configuration of a simulated UR cell: plain data, one TOML section.

use std::net::{IpAddr, Ipv4Addr};

use serde::{Deserialize, Serialize};
use tangent_simulated_device::Ports;
use tangent_simulated_ur::ControllerConfig;
use tangent_simulation::AdmittancePlantConfig;

/// A simulated cell: controller, sensor box and environment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Address to listen on; loopback, unless other hosts must reach the cell.
    #[serde(default = "loopback")]
    pub address: IpAddr,
    /// Ports of the servers.
    #[serde(default)]
    pub ports: Ports,
    /// The UR controller.
    #[serde(default)]
    pub controller: ControllerConfig,
    /// Arm, tool, surface and sensor.
    pub plant: AdmittancePlantConfig,
    /// Seed of all randomness.
    #[serde(default)]
    pub seed: u64,
    /// SCHED_FIFO priority of the threads of robot and sensor box, since load on this machine would
    /// not delay real devices; `None` for normal scheduling.
    #[serde(default)]
    pub realtime_priority: Option<u8>,
}

fn loopback() -> IpAddr {
    IpAddr::V4(Ipv4Addr::LOCALHOST)
}
