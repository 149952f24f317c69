//! `[realtime]`: scheduling of the real-time threads, and the order of their priorities.
//!
//! The order is checked: simulated robot and sensor box, loop, sensor, bus, estimator, camera. A
//! thread that carries data has priority over one that computes with it. A slow estimator then only
//! delays its own estimates, which the controller detects and bridges. If the bus had to wait for
//! the estimator, a loop in another process would miss the wrench, which ends the task.

use serde::Deserialize;

use crate::config::check::Checker;
use crate::config::load::ConfigError;
use crate::realtime::{RealtimeReport, setup_thread_on};

/// `[realtime]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// Whether to ask for SCHED_FIFO and locked memory.
    pub enabled: bool,
    /// SCHED_FIFO priority of the control loop's thread, 1 to 99.
    pub loop_priority: u8,
    /// SCHED_FIFO priority of the sensor's thread, 1 to 99.
    pub sensor_priority: u8,
    /// SCHED_FIFO priority of the estimator's thread, 1 to 99.
    pub estimator_priority: u8,
    /// SCHED_FIFO priority of the camera's thread, which finds the target in each image, 1 to 99.
    pub camera_priority: u8,
    /// SCHED_FIFO priority of the bus threads, which publish to other processes, and of Zenoh's
    /// own, 1 to 99.
    pub bus_priority: u8,
    /// SCHED_FIFO priority of the simulated robot and sensor box, 1 to 99. It is the highest, as
    /// load on this machine would not delay real devices.
    pub simulator_priority: u8,
    /// CPU that the control loop runs on; any if absent.
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
    /// Sets the calling thread up as the robot loop `name`, as far as this section asks for it.
    pub fn setup_loop(&self, name: &str) -> RealtimeReport {
        if self.enabled {
            setup_thread_on(name, self.loop_priority, self.loop_cpu)
        } else {
            RealtimeReport::not_asked(name)
        }
    }

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
                &format!("below {above}, which is {more}: threads that transport data need a higher priority than threads \
                    that process it"),
            )?;
        }
        Ok(())
    }

    /// Key and priority of each thread, the highest first.
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
