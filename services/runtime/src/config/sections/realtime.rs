//! `[realtime]`: scheduling of the threads that must be in time.

use serde::Deserialize;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[realtime]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// Ask for SCHED_FIFO and locked memory.
    pub enabled: bool,
    /// SCHED_FIFO priority of the control loop's thread, 1 to 99.
    pub loop_priority: u8,
    /// The same for the sensor's thread.
    pub sensor_priority: u8,
    /// The same for the estimator's thread.
    pub estimator_priority: u8,
    /// The same for the camera's thread, which finds the target in each image.
    pub camera_priority: u8,
    /// The same for the threads of the bus: publishing to other processes, and Zenoh's own.
    pub bus_priority: u8,
    /// The same for the simulated robot and sensor box: no load on this machine would delay the real ones.
    pub simulator_priority: u8,
    /// CPU that the control loop keeps to.
    pub loop_cpu: Option<usize>,
}

impl Default for RealtimeConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            loop_priority: 80,
            sensor_priority: 70,
            estimator_priority: 60,
            camera_priority: 30,
            bus_priority: 40,
            simulator_priority: 85,
            loop_cpu: None,
        }
    }
}

impl RealtimeConfig {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, priority) in [
            ("realtime.loop_priority", self.loop_priority),
            ("realtime.sensor_priority", self.sensor_priority),
            ("realtime.estimator_priority", self.estimator_priority),
            ("realtime.camera_priority", self.camera_priority),
            ("realtime.bus_priority", self.bus_priority),
            ("realtime.simulator_priority", self.simulator_priority),
        ] {
            checker.range(key, f64::from(priority), 1.0..=99.0, "")?;
        }
        Ok(())
    }
}
