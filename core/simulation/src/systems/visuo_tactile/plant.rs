//! The simulated cell of visuo-tactile scenarios: a torque-controlled arm with a soft pad and no
//! force sensor, a stiff surface, and a camera. It is stepped once per control period.

use nalgebra::{Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tangent_control::VisionInput;
use tangent_mechanics::{Base, Flange, Joints, Pose, Tool, Twist, Wrench};

use super::plant_config::{NormalSource, VisuoTactilePlantConfig, check};
use crate::arms::loaded_arm::true_arm;
use crate::arms::torque_arm::TorqueArm;
use crate::contact::{Obstacle, PadMotion};
use crate::plant_error::PlantError;
use crate::sensors::depth_source::DepthSource;
use crate::sensors::normal_camera::NormalCamera;
use crate::sensors::wrench_estimate::WrenchEstimate;
use crate::start;
use crate::start::StartConfig;
use crate::stated::StatedCell;
use crate::surfaces::Surface;
use crate::touch::Touch;
use crate::true_value::True;
use crate::truth::Truth;

/// Measurements that the arm reports after a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisuoTactileMeasurement<const N: usize = 7> {
    /// Time of measurement, s.
    pub time_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<N>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Wrench of the environment on the tool, as estimated by the robot.
    pub wrench: Wrench<Tool>,
    /// Joint torques that correspond to the estimated wrench of the environment, Nm.
    pub external_torque: Joints<N>,
}

/// Energy that has passed through the arm's ports since the plant was created, J. Tests compare a
/// law's energy balance with it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EnergyBooks {
    /// Energy from the motors, J.
    pub motors_j: f64,
    /// Energy from the environment, J.
    pub environment_j: f64,
    /// Energy dissipated by the joints' friction, J.
    pub friction_j: f64,
}

/// The camera, by the source of its normals.
enum Eye {
    Features(Box<NormalCamera>),
    Depth(Box<DepthSource>),
}

/// The simulated cell.
pub struct VisuoTactilePlant<const N: usize = 7> {
    config: VisuoTactilePlantConfig,
    arm: TorqueArm<N>,
    stated: StatedCell<N>,
    touch: Touch,
    wrench: WrenchEstimate<N>,
    camera: Eye,
    flange_from_tool: True<Pose<Flange, Tool>>,
    dt: f64,
    periods: u64,
    torque_applied: Joints<N>,
    joint_wrench: Joints<N>,
    push: Vector6<f64>,
    measured: VisuoTactileMeasurement<N>,
    books: EnergyBooks,
}

impl<const N: usize> VisuoTactilePlant<N> {
    /// Builds the cell at rest in its start pose, with the motors holding the arm.
    ///
    /// # Errors
    /// A key is wrong, with what is allowed, or the start pose cannot be reached, with the reason.
    pub fn new(config: &VisuoTactilePlantConfig, seed: u64) -> Result<Self, PlantError> {
        check(config)?;
        let stated = config.stated::<N>()?;
        let config = config.drawn(N, seed);
        let errors = &config.errors;
        let model = *true_arm::<N>(&config.robot, &config.tool)?.to_compare();
        let mut touch = Touch::new(&config.surface, &config.tool, &config.contact)?;
        if let Some(variation) = errors.friction {
            touch.vary_friction(variation);
        }
        let flange_from_tool = errors.frames.flange_from_tool(&config.tool);
        let place = spread_start(&config, seed);
        let target = start::tool_pose(&place, &touch.surface);
        let q = start::joints(&model, &flange_from_tool, &target, &place)?;
        touch.place_tool(&target);
        let gravity = model.gravity(&q);
        let mut plant = Self {
            wrench: WrenchEstimate::new(&config.external_wrench, stated.arm, seed)
                .with_errors(&errors.external_wrench),
            camera: match config.normals_from {
                NormalSource::Features => {
                    Eye::Features(Box::new(NormalCamera::new(&config.camera, seed)))
                }
                NormalSource::Depth => Eye::Depth(Box::new(DepthSource::new(
                    &config.depth_camera,
                    &config.depth_normal,
                    &stated.flange_from_tool,
                    &True::new(flange_from_tool),
                    seed,
                )?)),
            },
            arm: TorqueArm::new(model, &config.arm, q).with_errors(&config.arm, &errors.arm),
            stated,
            touch,
            flange_from_tool: True::new(flange_from_tool),
            dt: config.arm.period_s / config.arm.sub_steps as f64,
            periods: 0,
            torque_applied: gravity,
            joint_wrench: Joints::zeros(),
            push: Vector6::zeros(),
            measured: VisuoTactileMeasurement {
                time_s: 0.0,
                q,
                qd: Joints::zeros(),
                wrench: Wrench::zero(),
                external_torque: Joints::zeros(),
            },
            books: EnergyBooks::default(),
            config,
        };
        plant.measure();
        plant.expose();
        Ok(plant)
    }

    /// Runs one period under motor torques (Nm): from their delay line to the wrench estimate and
    /// the camera.
    pub fn step(&mut self, torque: &Joints<N>) {
        let active = self.arm.exchange(torque);
        let wanted = self.arm.limited(&active);
        let period = self.config.arm.period_s;
        self.torque_applied = self.arm.within_rate(&wanted, &self.torque_applied, period);
        for _ in 0..self.config.arm.sub_steps {
            self.sub_step();
        }
        self.periods += 1;
        self.measure();
        self.expose();
    }

    /// Exposes the camera at the arm's true pose. What is known of the exposure is what the arm
    /// measures.
    fn expose(&mut self) {
        let (time, seen) = (self.time_s(), self.true_base_from_flange());
        match &mut self.camera {
            Eye::Features(camera) => {
                camera.expose(time, &self.touch.surface, &self.touch.motion.origin);
            }
            Eye::Depth(source) => {
                let VisuoTactileMeasurement { q, qd, .. } = self.measured;
                let stated = &self.stated;
                let jacobian = stated.arm.jacobian_at(&q, &stated.flange_from_tool);
                let velocity = Twist::<Base>::from_vector(&(jacobian * qd)).linear;
                let measured = (stated.arm.base_from_flange(&q), velocity);
                source.expose(time, &seen, measured, &self.touch.surface);
            }
        }
    }

    fn sub_step(&mut self) {
        let dt = self.dt;
        let slope = self.arm.friction_slope(&self.arm.qd);
        self.arm.step(&self.torque_applied, &self.joint_wrench, dt);
        let (q, qd) = (self.arm.q, self.arm.qd);
        self.books.motors_j += self.torque_applied.dot(&qd) * dt;
        self.books.environment_j += self.joint_wrench.dot(&qd) * dt;
        self.books.friction_j += slope.component_mul(&qd).dot(&qd) * dt;
        let (tool, jacobian) = self
            .arm
            .model()
            .tool_and_jacobian(&q, self.flange_from_tool.to_compare());
        let twist = jacobian * qd;
        self.touch.step(PadMotion::moving(&tool, &twist), dt);
        let wrench = self.touch.contact.wrench() + self.push;
        self.joint_wrench = jacobian.tr_mul(&wrench);
    }

    fn measure(&mut self) {
        let (q, qd) = (self.arm.q_measured(), self.arm.qd_measured());
        let (tool, jacobian) = self
            .stated
            .arm
            .tool_and_jacobian(&q, &self.stated.flange_from_tool);
        let (wrench, external_torque) = self.wrench.step(
            &q,
            &qd,
            &self.torque_applied,
            &tool,
            &jacobian,
            self.config.arm.period_s,
        );
        self.measured = VisuoTactileMeasurement {
            time_s: self.time_s(),
            q,
            qd,
            wrench,
            external_torque,
        };
    }

    /// Puts an obstacle in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.touch.put_in_the_way(obstacle);
    }

    /// Sets an external wrench on the tool, base axes (N, then Nm); it acts until it is set again.
    pub fn push(&mut self, wrench: &Vector6<f64>) {
        self.push = *wrench;
    }

    /// Current measurements of the arm.
    pub fn measured(&self) -> VisuoTactileMeasurement<N> {
        self.measured
    }

    /// The newest normal of the camera that has arrived since the last call.
    pub fn take_normal(&mut self) -> Option<VisionInput> {
        let time = self.time_s();
        match &mut self.camera {
            Eye::Features(camera) => camera.take(time),
            Eye::Depth(source) => source.take(time),
        }
    }

    /// Number of frames that the camera has taken.
    pub fn frames(&self) -> u64 {
        match &self.camera {
            Eye::Features(camera) => camera.frames(),
            Eye::Depth(source) => source.frames(),
        }
    }

    /// Current true state of the contact.
    pub fn truth(&self) -> Truth {
        self.touch.truth(self.time_s())
    }

    /// Point of the surface on the line through `at` along `direction` (unit, against gravity),
    /// base axes: where a tool that moves down along `-direction` touches. `None` beyond the edges.
    pub fn surface_along(
        &self,
        at: &Vector3<f64>,
        direction: &Vector3<f64>,
    ) -> Option<Vector3<f64>> {
        let mut point = *at;
        for _ in 0..60 {
            let (distance, normal) = self.touch.surface.distance_and_normal(&point);
            let slope = normal.dot(direction);
            if slope < 0.1 {
                return None;
            }
            point -= direction * (distance / slope);
            if distance.abs() < 1e-9 {
                return Some(point);
            }
        }
        None
    }

    /// Time since the plant was created, s.
    pub fn time_s(&self) -> f64 {
        self.periods as f64 * self.config.arm.period_s
    }

    /// Time per step, s.
    pub fn period_s(&self) -> f64 {
        self.config.arm.period_s
    }

    /// The arm with its true payload.
    pub fn arm(&self) -> &TorqueArm<N> {
        &self.arm
    }

    /// The surface under the tool.
    pub fn surface(&self) -> &Surface {
        &self.touch.surface
    }

    /// `flange_from_tool` as stated.
    pub fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.stated.flange_from_tool
    }

    /// True pose of the tool on the flange.
    pub fn true_flange_from_tool(&self) -> True<Pose<Flange, Tool>> {
        self.flange_from_tool
    }

    /// True pose of the flange: where a camera on it is, whatever the encoders measure.
    pub fn true_base_from_flange(&self) -> True<Pose<Base, Flange>> {
        True::new(self.arm.model().base_from_flange(&self.arm.q))
    }

    /// Motor torques of the last period, Nm.
    pub fn torque_applied(&self) -> Joints<N> {
        self.torque_applied
    }

    /// Energy through the ports so far.
    pub fn energy(&self) -> EnergyBooks {
        self.books
    }
}

/// Start pose, varied by the seed.
fn spread_start(config: &VisuoTactilePlantConfig, seed: u64) -> StartConfig {
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x57a2_7b3a_d0c1_f00d);
    let mut share = || -> f64 { rng.random_range(-1.0..=1.0) };
    let (spread, mut start) = (config.start_spread, config.start.clone());
    if spread.tilt_rad > 0.0 {
        start.tilt_rad += share() * spread.tilt_rad;
        start.tilt_direction_rad += share() * std::f64::consts::PI;
    }
    for x in &mut start.near_m {
        *x += share() * spread.position_m;
    }
    start.clearance_m += share() * spread.clearance_m;
    start
}
