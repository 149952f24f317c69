//! How the simulated Franka behaves: plain data.

use std::net::{IpAddr, Ipv4Addr};

use serde::{Deserialize, Serialize};

use super::bench::PlantConfig;
use crate::config::Ports;

/// Robot, what it stands in, and where it listens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FciConfig {
    /// Address to listen on: loopback unless others shall reach the robot.
    pub address: IpAddr,
    /// Where to listen: FCI's port plus an offset, or any.
    pub ports: Ports,
    /// Arm, tool and plane.
    pub plant: PlantConfig,
    /// The robot waits so long for the answer to a state while a motion runs, s. A real one waits a
    /// part of a millisecond; more makes simulated time wait for a busy machine instead of losing
    /// answers.
    pub answer_wait_s: f64,
    /// From a move request to the motion, cycles.
    pub start_cycles: u32,
    /// A recovery takes so long, s.
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
