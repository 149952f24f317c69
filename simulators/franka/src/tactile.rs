//! The cell of `visuo_tactile` scenarios with the interface of the simulated robot: a Panda, its
//! pad and the surface under it.

use std::sync::mpsc::SyncSender;

use nalgebra::Vector6;
use tangent_mechanics::{Flange, Joints, Pose, Tool};
use tangent_runtime::clock::now_ns;
use tangent_simulation::{
    NormalSource, PlantError, Surface, Truth, VisuoTactilePlant, VisuoTactilePlantConfig,
};

use crate::depth_eye::Look;
use crate::plant::{ArmReading, TorquePlant};

/// The plant of a `visuo_tactile` scenario as the simulated robot's arm.
pub struct TactileArm {
    plant: VisuoTactilePlant,
    eye: Option<Eye>,
}

/// Destination and rate of the camera's exposures.
struct Eye {
    looks: SyncSender<Look>,
    rate_hz: f64,
    taken: u64,
}

impl TactileArm {
    /// Creates the arm at rest in the start pose of the scenario. An answer takes effect after
    /// `delay_periods`, besides the one period of the interface itself. The camera is not part of
    /// the arm: no frame is taken here.
    ///
    /// # Errors
    /// A key is out of its range, or the arm cannot reach the start pose.
    pub fn new(
        config: &VisuoTactilePlantConfig,
        delay_periods: usize,
        seed: u64,
    ) -> Result<Self, PlantError> {
        let mut config = config.clone();
        config.arm.delay_periods = delay_periods;
        config.camera.rate_hz = 0.0;
        config.normals_from = NormalSource::Features;
        Ok(Self {
            plant: VisuoTactilePlant::<7>::new(&config, seed)?,
            eye: None,
        })
    }

    /// The surface, for the camera that sees it.
    pub fn surface(&self) -> &Surface {
        self.plant.surface()
    }

    /// From now on exposes the camera `rate_hz` times a second.
    pub fn watched_by(&mut self, looks: SyncSender<Look>, rate_hz: f64) {
        self.eye = Some(Eye {
            looks,
            rate_hz,
            taken: 0,
        });
    }

    /// Exposes the camera if an exposure is due.
    fn look(&mut self) {
        let Some(eye) = &mut self.eye else {
            return;
        };
        let time_s = self.plant.time_s();
        if eye.rate_hz <= 0.0 || time_s + 1e-9 < eye.taken as f64 / eye.rate_hz {
            return;
        }
        eye.taken = (time_s * eye.rate_hz + 1e-6).floor() as u64 + 1;
        // If the renderer is behind, the exposure is left out, as with a real camera.
        let _ = eye.looks.try_send(Look {
            time_s,
            stamp_ns: now_ns(),
            base_from_flange: *self.plant.true_base_from_flange().to_compare(),
        });
    }
}

impl TorquePlant for TactileArm {
    fn step(&mut self, torque: &Joints<7>) {
        self.plant.step(torque);
        self.look();
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
