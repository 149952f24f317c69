//! The cell of `visuo_tactile` scenarios behind the simulated robot's interface: a Panda, its pad and the surface under it.

use nalgebra::Vector6;
use tangent_mechanics::{Flange, Joints, Pose, Tool};
use tangent_simulation::{PlantError, TactilePlant, TactilePlantConfig, Truth};

use super::plant::{ArmReading, TorquePlant};

/// See the module. The robot's own interface makes the delay that the closed loop has in its plant.
pub struct TactileArm {
    plant: TactilePlant,
}

impl TactileArm {
    /// At rest where the scenario starts. The camera is not part of the arm: no frame is taken here.
    ///
    /// # Errors
    /// A key out of its range, or a start that the arm cannot reach.
    pub fn new(config: &TactilePlantConfig, seed: u64) -> Result<Self, PlantError> {
        let mut config = config.clone();
        config.arm.delay_periods = 0;
        config.camera.rate_hz = 0.0;
        Ok(Self {
            plant: TactilePlant::new(&config, seed)?,
        })
    }
}

impl TorquePlant for TactileArm {
    fn step(&mut self, torque: &Joints<7>) {
        self.plant.step(torque);
    }

    fn reading(&self) -> ArmReading {
        let measured = self.plant.measured();
        ArmReading {
            q: measured.q,
            qd: measured.qd,
            external: measured.external_torque,
        }
    }

    fn truth(&self) -> Option<Truth> {
        Some(self.plant.truth())
    }

    fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.plant.flange_from_tool()
    }

    fn push(&mut self, force_n: [f64; 3]) {
        let [x, y, z] = force_n;
        self.plant.push(&Vector6::new(x, y, z, 0.0, 0.0, 0.0));
    }
}
