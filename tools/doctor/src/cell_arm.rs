//! The kind of arm that the cell file names.

use tangent_runtime::CellConfig;
use tangent_runtime::config::{Law, RobotDriver, SensorDriver};

/// Interface of the cell's arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CellArm {
    /// RTDE, with a separate force/torque sensor box.
    UniversalRobots,
    /// FCI; the robot measures its external torques itself.
    Franka,
    /// An arm with a torque interface on the bus, which exists only as a simulator; its sensor box
    /// is simulated too.
    OnTheBus,
}

impl CellArm {
    pub(crate) fn of(config: &CellConfig) -> Self {
        match (config.robot.driver, config.controller.law) {
            (RobotDriver::Franka, _) => Self::Franka,
            (RobotDriver::Rtde, Law::HybridAdmittance) => Self::UniversalRobots,
            (RobotDriver::Rtde, _) => Self::OnTheBus,
        }
    }

    /// Whether the wrench comes from a Net F/T box.
    pub(crate) fn has_sensor_box(self, config: &CellConfig) -> bool {
        self != Self::Franka && config.sensor.driver == SensorDriver::Netft
    }
}
