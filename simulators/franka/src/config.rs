//! Configuration of the simulated Franka.

use std::net::{IpAddr, Ipv4Addr};

use serde::{Deserialize, Serialize};
use tangent_simulated_device::Ports;

use crate::bench::PlantConfig;

/// Robot, environment and network address.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FciConfig {
    /// Address to listen on; loopback, unless other hosts must reach the robot.
    pub address: IpAddr,
    /// Ports: FCI's port plus an offset, or any free ones.
    pub ports: Ports,
    /// Arm, tool and plane.
    pub plant: PlantConfig,
    /// Longest wait of the robot for the answer to a state while a motion runs, s. A real robot
    /// waits for a part of a millisecond. With a longer wait, simulated time waits for a busy
    /// machine instead of losing answers.
    pub answer_wait_s: f64,
    /// Time from a move request to the motion, cycles.
    pub start_cycles: u32,
    /// Duration of a recovery, s.
    pub recovery_s: f64,
    /// SCHED_FIFO priority of the robot's thread; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

impl Default for FciConfig {
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            ports: Ports::default(),
            plant: PlantConfig::default(),
            answer_wait_s: 0.0007,
            start_cycles: 5,
            recovery_s: 0.3,
            realtime_priority: None,
        }
    }
}
