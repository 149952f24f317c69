//! `[realtime]`: scheduling of the threads that must be in time, and which of them goes first.
//!
//! The order is checked: robot and box (where they are simulated), loop, sensor, bus, estimator, camera. What only carries data goes before
//! what computes with it: an estimator that takes long is late itself, which the controller notices and bridges; a bus that waits for it
//! would take the wrench from a loop in another process, which ends the task.

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
            sensor_priority: 75,
            bus_priority: 70,
            estimator_priority: 65,
            camera_priority: 30,
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
        let order = self.order();
        for ((above, more), (key, priority)) in order.iter().zip(&order[1..]) {
            checker.require(
                priority < more,
                key,
                priority,
                &format!("below {above}, which is {more}: what carries data goes before what computes with it"),
            )?;
        }
        Ok(())
    }

    /// Key and priority, the most urgent first.
    pub fn order(&self) -> [(&'static str, u8); 6] {
        [
            ("realtime.simulator_priority", self.simulator_priority),
            ("realtime.loop_priority", self.loop_priority),
            ("realtime.sensor_priority", self.sensor_priority),
            ("realtime.bus_priority", self.bus_priority),
            ("realtime.estimator_priority", self.estimator_priority),
            ("realtime.camera_priority", self.camera_priority),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(text: &str) -> Result<(), String> {
        let config: RealtimeConfig = toml::from_str(text).unwrap();
        let file = format!("[realtime]\n{text}");
        config
            .check(&Checker::new("cell.toml", &file))
            .map_err(|e| e.to_string())
    }

    #[test]
    fn the_default_is_in_order_and_another_order_names_both_keys() {
        assert_eq!(check(""), Ok(()));
        assert_eq!(
            check(
                "loop_priority = 60\nsensor_priority = 50\nbus_priority = 40\nestimator_priority = 31"
            ),
            Ok(())
        );
        for (text, key, above) in [
            (
                "bus_priority = 40",
                "realtime.estimator_priority",
                "realtime.bus_priority",
            ),
            (
                "loop_priority = 70",
                "realtime.sensor_priority",
                "realtime.loop_priority",
            ),
            (
                "sensor_priority = 80",
                "realtime.sensor_priority",
                "realtime.loop_priority",
            ),
            (
                "bus_priority = 76",
                "realtime.bus_priority",
                "realtime.sensor_priority",
            ),
            (
                "camera_priority = 65",
                "realtime.camera_priority",
                "realtime.estimator_priority",
            ),
            (
                "loop_priority = 90",
                "realtime.loop_priority",
                "realtime.simulator_priority",
            ),
        ] {
            let error = check(text).unwrap_err();
            assert!(
                error.contains(key) && error.contains(above),
                "{text}: {error}"
            );
        }
        assert!(
            check("camera_priority = 0")
                .unwrap_err()
                .contains("from 1 to 99")
        );
    }
}
