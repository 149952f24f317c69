//! The cell of `visuo_tactile` scenarios with the interface of the simulated robot: a Panda, its
//! pad and the surface under it.

use nalgebra::{Matrix3, Vector6};
use tangent_mechanics::{Flange, Joints, Payload, Pose, Tool};
use tangent_simulated_device::Shutter;
use tangent_simulation::{
    NormalSource, PlantError, Surface, ToolConfig, True, Truth, VisuoTactilePlant,
    VisuoTactilePlantConfig,
};

use crate::plant::{ArmReading, TorquePlant};

/// The plant of a `visuo_tactile` scenario as the simulated robot's arm.
pub struct TactileArm {
    plant: VisuoTactilePlant,
    declared_load: Payload,
    camera: Option<Shutter>,
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
        let declared_load = declared_load(&config.tool);
        Ok(Self {
            plant: VisuoTactilePlant::<7>::new(&config, seed)?,
            declared_load,
            camera: None,
        })
    }

    /// The surface, for the camera that sees it.
    pub fn surface(&self) -> &Surface {
        self.plant.surface()
    }

    /// True pose of the tool on the flange, for the camera that sees it.
    pub fn true_flange_from_tool(&self) -> True<Pose<Flange, Tool>> {
        self.plant.true_flange_from_tool()
    }

    /// From now on exposes this camera.
    pub fn watched_by(&mut self, camera: Shutter) {
        self.camera = Some(camera);
    }
}

/// The tool's load as the scenario states it, which may differ from the true one.
fn declared_load(tool: &ToolConfig) -> Payload {
    let stated = &tool.payload;
    let flange_from_sensor = tool.flange_from_sensor.isometry();
    let turn = flange_from_sensor.rotation.to_rotation_matrix();
    let inertia = Matrix3::from_diagonal(&stated.inertia_kg_m2.into());
    Payload {
        mass_kg: stated.mass_kg,
        com_in_flange_m: flange_from_sensor
            .transform_point(&stated.com_in_sensor_m.into())
            .coords,
        inertia_kg_m2: turn * inertia * turn.transpose(),
    }
}

impl TorquePlant for TactileArm {
    fn step(&mut self, torque: &Joints<7>) {
        self.plant.step(torque);
        if let Some(camera) = &mut self.camera {
            camera.look(self.plant.time_s(), &self.plant.true_base_from_flange());
        }
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

    fn declared_load(&self) -> Payload {
        self.declared_load
    }

    /// The plant of a scenario consists of links alone.
    fn motor_inertia(&self) -> Joints<7> {
        Joints::zeros()
    }

    fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.plant.flange_from_tool()
    }

    fn push(&mut self, force_n: [f64; 3]) {
        let [x, y, z] = force_n;
        self.plant.push(&Vector6::new(x, y, z, 0.0, 0.0, 0.0));
    }
}
