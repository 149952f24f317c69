//! A Panda with a tool in front of a plane: full rigid-body dynamics, a spring and damper for the
//! contact, and a momentum observer for the robot's wrench estimate. Used if no scenario is given.

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{
    Arm, Flange, Joints, ModelData, ModelError, Payload, Pose, Tool, Twist, Wrench,
};
use tangent_simulation::{TorqueArm, TorqueArmConfig, Truth};

use crate::plant::{ArmReading, TorquePlant};

/// Seed of the noise: every run has the same.
const NOISE_SEED: u64 = 0x0f0a_11ca;
/// Inertia of the tool about its centre of mass, any axis, kg m².
const TOOL_INERTIA_KG_M2: f64 = 0.001;
/// Speed at which friction has reached 71 % of its value, m/s.
const STICK_SPEED_M_PER_S: f64 = 0.002;

/// A plane that the tool can touch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plane {
    /// A point of the plane, base axes, m.
    pub point_m: [f64; 3],
    /// Normal of the plane, out of the material, base axes; need not be of unit length.
    pub normal: [f64; 3],
    /// Stiffness of the contact, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the contact, N s/m.
    pub damping_n_s_per_m: f64,
    /// Friction coefficient.
    pub friction: f64,
}

/// The arm, its tool and the plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantConfig {
    /// Position of the tool's origin on the flange, m.
    pub tool_m: [f64; 3],
    /// Rotation of the tool on the flange, rotation vector, rad.
    pub tool_rotation_rad: [f64; 3],
    /// Mass of the tool, kg.
    pub tool_mass_kg: f64,
    /// Centre of mass of the tool on the flange, m.
    pub tool_com_m: [f64; 3],
    /// Joint positions at the start, rad.
    pub q_rad: [f64; 7],
    /// Plane that the tool can touch; `None` for free space.
    pub plane: Option<Plane>,
    /// Inertia of the motors as the joints carry it, kg m²: of the rotor, times the square of the
    /// gear ratio. It is several times that of the last links, so that a law that is stable on a
    /// real arm would not be stable on links alone. 0.1 kg m² is what simulators of this arm use
    /// (MuJoCo Menagerie, `franka_emika_panda`).
    pub motor_inertia_kg_m2: [f64; 7],
    /// Viscous friction of all joints, Nm s/rad.
    pub viscous_nm_s_per_rad: f64,
    /// Bandwidth of the robot's estimate of external torque, rad/s.
    pub observer_rad_per_s: f64,
    /// White noise of the measured torques, standard deviation per period, Nm. Without noise, the
    /// estimate repeats exactly while the arm rests, as no real one does.
    pub torque_noise_nm: f64,
    /// Number of integration steps per period.
    pub sub_steps: usize,
}

impl Default for PlantConfig {
    fn default() -> Self {
        Self {
            tool_m: [0.0, 0.0, 0.12],
            tool_rotation_rad: [0.0; 3],
            tool_mass_kg: 0.3,
            tool_com_m: [0.0, 0.0, 0.05],
            q_rad: [
                0.0,
                -std::f64::consts::FRAC_PI_4,
                0.0,
                -3.0 * std::f64::consts::FRAC_PI_4,
                0.0,
                std::f64::consts::FRAC_PI_2,
                std::f64::consts::FRAC_PI_4,
            ],
            plane: None,
            motor_inertia_kg_m2: [0.1; 7],
            viscous_nm_s_per_rad: 0.05,
            observer_rad_per_s: 150.0,
            torque_noise_nm: 0.01,
            sub_steps: 4,
        }
    }
}

/// The simulated Panda with its tool and plane.
#[derive(Clone, Debug)]
pub struct BenchPlant {
    config: PlantConfig,
    arm: TorqueArm<7>,
    flange_from_tool: Pose<Flange, Tool>,
    external_estimate: Joints<7>,
    rng: Pcg64Mcg,
    push: Vector3<f64>,
    time_s: f64,
}

struct Touch {
    force: Vector3<f64>,
    depth_m: f64,
    normal: Vector3<f64>,
    point: Vector3<f64>,
}

impl BenchPlant {
    /// Creates the plant at rest.
    ///
    /// # Errors
    /// The built-in model is not valid.
    pub fn new(config: &PlantConfig) -> Result<Self, ModelError> {
        let model = Arm::<7>::new(&ModelData::builtin("panda")?)?.with_payload(&tool(config));
        let friction = TorqueArmConfig {
            viscous_nm_s_per_rad: vec![config.viscous_nm_s_per_rad],
            ..TorqueArmConfig::default()
        };
        Ok(Self {
            arm: TorqueArm::new(model, &friction, Joints::from(config.q_rad))
                .with_motor_inertia(Joints::from(config.motor_inertia_kg_m2)),
            flange_from_tool: Pose::new(
                Vector3::from(config.tool_m),
                UnitQuaternion::from_scaled_axis(Vector3::from(config.tool_rotation_rad)),
            ),
            config: config.clone(),
            external_estimate: Joints::zeros(),
            rng: Pcg64Mcg::seed_from_u64(NOISE_SEED),
            push: Vector3::zeros(),
            time_s: 0.0,
        })
    }

    /// Contact of the plane with the tool at `tool` (m), which moves at `v` (m/s), base axes.
    fn touch(&self, tool: &Vector3<f64>, v: &Vector3<f64>) -> Option<Touch> {
        let plane = self.config.plane?;
        let normal = Vector3::from(plane.normal).try_normalize(1e-9)?;
        let depth_m = -(tool - Vector3::from(plane.point_m)).dot(&normal);
        let (along, mut force, mut pressing) = (v.dot(&normal), Vector3::zeros(), 0.0);
        if depth_m > 0.0 {
            // A surface can push, but not pull.
            pressing =
                (plane.stiffness_n_per_m * depth_m - plane.damping_n_s_per_m * along).max(0.0);
            let slide = v - normal * along;
            let speed = slide.norm().hypot(STICK_SPEED_M_PER_S);
            force = normal * pressing - slide * (plane.friction * pressing / speed);
        }
        Some(Touch {
            force,
            depth_m: if pressing > 0.0 { depth_m } else { 0.0 },
            normal,
            point: tool + normal * depth_m,
        })
    }
}

/// The tool as a body on the flange.
fn tool(config: &PlantConfig) -> Payload {
    Payload {
        mass_kg: config.tool_mass_kg,
        com_in_flange_m: Vector3::from(config.tool_com_m),
        inertia_kg_m2: Matrix3::identity() * TOOL_INERTIA_KG_M2,
    }
}

impl TorquePlant for BenchPlant {
    fn step(&mut self, torque: &Joints<7>) {
        let steps = self.config.sub_steps.max(1);
        let dt = 1e-3 / steps as f64;
        let motor = self.arm.limited(torque);
        let noise = Joints::from_fn(|_, _| {
            let normal: f64 = StandardNormal.sample(&mut self.rng);
            self.config.torque_noise_nm * normal
        });
        for _ in 0..steps {
            let (pose, jacobian) = self
                .arm
                .model()
                .tool_and_jacobian(&self.arm.q, &self.flange_from_tool);
            let v: Vector3<f64> = (jacobian * self.arm.qd).fixed_rows::<3>(0).into_owned();
            let force = self
                .touch(&pose.translation(), &v)
                .map_or(Vector3::zeros(), |touch| touch.force)
                + self.push;
            let external = jacobian.fixed_rows::<3>(0).transpose() * force;
            let before = self.arm.qd;
            let (mass, bias) = self
                .arm
                .model()
                .mass_matrix_and_bias(&self.arm.q, &self.arm.qd);
            self.arm.step(torque, &external, dt);
            // External torque inferred from the motion and the motor torque, low-pass filtered by
            // the observer.
            let inertia = mass + SMatrix::from_diagonal(&self.motor_inertia());
            let seen = inertia * (self.arm.qd - before) / dt + bias - motor + noise;
            let share = 1.0 - (-self.config.observer_rad_per_s * dt).exp();
            self.external_estimate += (seen - self.external_estimate) * share;
        }
        self.time_s += 1e-3;
    }

    fn reading(&self) -> ArmReading {
        ArmReading {
            q: self.arm.q_measured(),
            qd: self.arm.qd_measured(),
            external: self.external_estimate,
        }
    }

    fn truth(&self) -> Option<Truth> {
        let model = self.arm.model();
        let (pose, jacobian) = model.tool_and_jacobian(&self.arm.q, &self.flange_from_tool);
        let twist = Twist::from_vector(&(jacobian * self.arm.qd));
        let touch = self.touch(&pose.translation(), &twist.linear)?;
        let pressing = touch.force.dot(&touch.normal);
        let across = (touch.force - touch.normal * pressing).norm();
        let along = twist.linear.dot(&touch.normal);
        Some(Truth {
            time_s: self.time_s,
            point: touch.point,
            normal: touch.normal,
            curvature: Matrix3::zeros(),
            distance_m: (pose.translation() - touch.point).dot(&touch.normal),
            in_contact: pressing > 0.0,
            load_n: pressing.max(0.0),
            penetration_m: touch.depth_m,
            wrench: Wrench::new(touch.force, Vector3::zeros()),
            base_from_tool: pose,
            twist,
            sliding_speed_m_per_s: (twist.linear - touch.normal * along).norm(),
            friction_ratio: if pressing > 0.0 {
                across / pressing
            } else {
                0.0
            },
            friction_coefficient: self.config.plane.map_or(0.0, |plane| plane.friction),
            world_from_base: Pose::identity(),
        })
    }

    fn declared_load(&self) -> Payload {
        tool(&self.config)
    }

    fn motor_inertia(&self) -> Joints<7> {
        Joints::from(self.config.motor_inertia_kg_m2)
    }

    fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.flange_from_tool
    }

    fn push(&mut self, force_n: [f64; 3]) {
        self.push = Vector3::from(force_n);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_estimate_settles_on_the_external_force() {
        let mut plant = BenchPlant::new(&PlantConfig::default()).unwrap();
        let model = *plant.arm.model();
        plant.push([3.0, -2.0, 5.0]);
        let q = plant.arm.q;
        for _ in 0..3000 {
            // A stiff controller holds the arm in place.
            let mass = model.mass_matrix(&plant.arm.q);
            let hold = mass * ((q - plant.arm.q) * 900.0 - plant.arm.qd * 60.0);
            let torque = model.gravity(&plant.arm.q) + hold;
            plant.step(&torque);
        }
        let (_, jacobian) = model.tool_and_jacobian(&plant.arm.q, &plant.flange_from_tool);
        let push: nalgebra::Vector6<f64> = nalgebra::vector![3.0, -2.0, 5.0, 0.0, 0.0, 0.0];
        let wanted = jacobian.transpose() * push;
        let error = (plant.reading().external - wanted).amax();
        assert!(error < 0.02, "{error} Nm off");
    }

    #[test]
    fn the_plane_pushes_and_never_pulls() {
        let config = PlantConfig {
            plane: Some(Plane {
                point_m: [0.0, 0.0, 0.3],
                normal: [0.0, 0.0, 2.0],
                stiffness_n_per_m: 1e4,
                damping_n_s_per_m: 50.0,
                friction: 0.3,
            }),
            ..PlantConfig::default()
        };
        let plant = BenchPlant::new(&config).unwrap();
        let at = |z: f64, vz: f64| {
            let (tool, v) = (Vector3::new(0.4, 0.0, z), Vector3::new(0.05, 0.0, vz));
            plant.touch(&tool, &v).unwrap().force
        };
        assert_eq!(at(0.3001, 0.0), Vector3::zeros());
        let force = at(0.299, 0.0);
        assert!((force.z - 10.0).abs() < 1e-9);
        assert!((force.x / force.z + 0.3).abs() < 0.01, "{force}");
        assert_eq!(at(0.299, 1.0), Vector3::zeros());
    }
}
