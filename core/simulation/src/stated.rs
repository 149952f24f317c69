//! What a cell file states, and what is true of the simulated cell: two types, so that the compiler
//! refuses to hand the truth to a law, an estimator or the conditioning.
//!
//! [`StatedCell`] is made from the file alone. A plant hands out what it really is only as
//! [`True`](crate::True).

use tangent_control::TorqueInterface;
use tangent_mechanics::{Arm, Flange, Pose, Sensor, Tool};

use crate::arms::loaded_arm::stated_arm;
use crate::plant_error::PlantError;
use crate::tool::ToolConfig;

/// The cell of a torque-controlled arm with `N` joints, as its file states it.
#[derive(Clone, Copy, Debug)]
pub struct StatedCell<const N: usize> {
    /// The arm with the payload on its flange.
    pub arm: Arm<N>,
    /// Pose of the tool on the flange.
    pub flange_from_tool: Pose<Flange, Tool>,
    /// Pose of the force/torque sensor on the flange.
    pub flange_from_sensor: Pose<Flange, Sensor>,
    /// Delay of the arm's torque interface.
    pub interface: TorqueInterface,
}

impl<const N: usize> StatedCell<N> {
    /// The cell with the built-in arm `robot`, a tool, and a delay of `delay_periods` periods from
    /// a measurement to the torque that answers it.
    ///
    /// # Errors
    /// An unknown robot, or one with a different number of joints.
    pub fn new(robot: &str, tool: &ToolConfig, delay_periods: usize) -> Result<Self, PlantError> {
        Ok(Self {
            arm: stated_arm(robot, tool)?,
            flange_from_tool: Pose::from_isometry(tool.flange_from_tool.isometry()),
            flange_from_sensor: Pose::from_isometry(tool.flange_from_sensor.isometry()),
            interface: TorqueInterface {
                delay_periods,
                ..TorqueInterface::default()
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tool::PayloadErrorConfig;

    #[test]
    fn the_stated_arm_does_not_know_the_error_of_the_payload() {
        let exact = ToolConfig::default();
        let tool = ToolConfig {
            payload_error: PayloadErrorConfig {
                mass_kg: 0.1,
                com_in_sensor_m: [0.01, 0.0, 0.0],
            },
            ..exact.clone()
        };
        let cell = StatedCell::<7>::new("panda", &tool, 1).unwrap();
        let q = cell.arm.home();
        let gravity = cell.arm.gravity(&q);
        let of_exact = StatedCell::<7>::new("panda", &exact, 1).unwrap();
        assert_eq!(gravity, of_exact.arm.gravity(&q));
        let truth = crate::arms::loaded_arm::true_arm::<7>("panda", &tool).unwrap();
        assert!((truth.to_compare().gravity(&q) - gravity).amax() > 0.1);
    }
}
