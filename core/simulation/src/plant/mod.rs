//! The simulated cell: arm, tool, surface and sensor, one arm period per step. Driven by the live
//! simulator and by `evaluate`.

mod check;

use nalgebra::{Isometry3, UnitQuaternion, Vector3, Vector6};
use tangent_mechanics::{
    Arm, Flange, Joints, ModelData, Pose, Sensor as SensorFrame, Tool, Wrench,
};

use crate::compliance::Compliance;
use crate::contact::{Pad, PadContact, PadMotion};
use crate::measurement::{ArmMeasurement, SensorSample, VelocityCommand};
use crate::obstacle::{Obstacle, Placed};
use crate::plant_config::PlantConfig;
use crate::plant_error::PlantError;
use crate::platform::{OdometrySample, Platform};
use crate::pose_config::PoseConfig;
use crate::sensor_load::{Body, SensorLoad};
use crate::sensor_records::SensorRecords;
use crate::servo::Servo;
use crate::start;
use crate::surfaces::Surface;
use crate::truth::Truth;

/// The simulated cell.
#[derive(Clone, Debug)]
pub struct Plant {
    config: PlantConfig,
    arm: Arm<6>,
    servo: Servo,
    surface: Surface,
    pad: Pad,
    compliance: Option<Compliance>,
    sensor: SensorRecords,
    platform: Option<Platform>,
    flange_from_tool: Pose<Flange, Tool>,
    load: SensorLoad,
    sub_steps: usize,
    dt: f64,
    periods: u64,
    body: Body,
    motion: PadMotion,
    contact: PadContact,
    obstacle: Option<Placed>,
}

impl Plant {
    /// Builds the cell at rest in its start pose. Equal configuration and seed give equal bits for
    /// ever after.
    ///
    /// # Errors
    /// Says which key is wrong and what is allowed, or why the start pose cannot be reached.
    pub fn new(config: &PlantConfig, seed: u64) -> Result<Self, PlantError> {
        check::check(config)?;
        let arm = Arm::<6>::new(&ModelData::builtin(&config.robot)?)?;
        let surface_pose = PoseConfig {
            position_m: config.surface.position_m,
            roll_pitch_yaw_rad: config.surface.roll_pitch_yaw_rad,
        };
        let surface = Surface::new(&config.surface.shape, &surface_pose)?;
        let flange_from_tool = Pose::from_isometry(config.tool.flange_from_tool.isometry());
        let target = start::tool_pose(&config.start, &surface);
        let q = start::joints(&arm, &flange_from_tool, &target, &config.start)?;

        let pad_stiffness = match &config.tool.compliance {
            None => config.contact.stiffness_n_per_m,
            Some(c) => {
                1.0 / (1.0 / config.contact.stiffness_n_per_m - 1.0 / c.stiffness_n_per_m[2])
            }
        };
        let sub_steps = (config.arm.period_s / config.substep_max_s - 1e-9)
            .ceil()
            .max(1.0) as usize;
        let mut plant = Self {
            servo: Servo::new(&config.arm, arm.limits(), q),
            pad: Pad::new(&config.tool.pad, &config.contact, pad_stiffness),
            compliance: config.tool.compliance.as_ref().map(Compliance::new),
            sensor: SensorRecords::new(&config.sensor, config.arm.period_s, seed, Vector6::zeros()),
            load: SensorLoad::new(&config.tool),
            platform: config.base.as_ref().map(|base| Platform::new(base, seed)),
            dt: config.arm.period_s / sub_steps as f64,
            sub_steps,
            periods: 0,
            body: Body::at_rest(*arm.base_from_flange(&q).isometry()),
            motion: PadMotion {
                origin: target.translation(),
                rotation: target.rotation(),
                linear: Vector3::zeros(),
                angular: Vector3::zeros(),
            },
            contact: PadContact::none(),
            obstacle: None,
            config: config.clone(),
            arm,
            surface,
            flange_from_tool,
        };
        let wrench = plant.sensor_wrench(&plant.body, &Vector3::zeros(), &Vector3::zeros());
        plant.sensor.set_wrench(wrench);
        Ok(plant)
    }

    /// One arm period under `command`, from its delay line to the sensor's samples.
    pub fn step(&mut self, command: &VelocityCommand) {
        self.sensor.clear();
        let active = self.servo.exchange(command);
        let start = self.periods as f64 * self.config.arm.period_s;
        for sub_step in 0..self.sub_steps {
            self.servo.step(&active, self.dt);
            self.sub_step(start + sub_step as f64 * self.dt);
        }
        self.periods += 1;
        if let Some(platform) = &mut self.platform {
            platform.step(start + self.config.arm.period_s);
        }
    }

    /// A pose of the base, in floor axes.
    fn on_floor(&self, pose: Isometry3<f64>, time_s: f64) -> Isometry3<f64> {
        match &self.platform {
            Some(platform) => platform.pose(time_s) * pose,
            None => pose,
        }
    }

    fn sub_step(&mut self, time_before: f64) {
        let dt = self.dt;
        let pose = *self.arm.base_from_flange(&self.servo.q).isometry();
        let pose = self.on_floor(pose, time_before + dt);
        // Velocity from positions, so that power times time is exactly the work along the path.
        let before = self.body;
        let turn = pose.rotation * before.pose.rotation.inverse();
        let body = Body {
            pose,
            linear: (pose.translation.vector - before.pose.translation.vector) / dt,
            angular: small_rotation(&turn) / dt,
        };
        let acceleration = (body.linear - before.linear) / dt;
        let angular_acceleration = (body.angular - before.angular) / dt;

        let lever = pose.rotation * self.flange_from_tool.translation();
        let rigid = PadMotion {
            origin: pose.translation.vector + lever,
            rotation: pose.rotation * self.flange_from_tool.rotation(),
            linear: body.linear + body.angular.cross(&lever),
            angular: body.angular,
        };
        let (mut contact, motion) = match &mut self.compliance {
            None => (self.pad.step(&self.surface, &rigid, dt, None), rigid),
            Some(compliance) => compliance.step(&mut self.pad, &self.surface, &rigid, dt),
        };
        if let Some(obstacle) = &self.obstacle {
            obstacle.push(&motion.origin, &mut contact);
        }
        (self.contact, self.motion) = (contact, motion);
        self.body = body;
        let wrench = self.sensor_wrench(&body, &acceleration, &angular_acceleration);
        self.sensor.advance(time_before, dt, wrench);
    }

    /// Contact, gravity and inertia of the payload on the sensor, N and Nm, sensor axes.
    fn sensor_wrench(
        &self,
        body: &Body,
        acceleration: &Vector3<f64>,
        angular_acceleration: &Vector3<f64>,
    ) -> Vector6<f64> {
        self.load.wrench(
            body,
            acceleration,
            angular_acceleration,
            &self.contact,
            &self.motion.origin,
        )
    }

    /// Puts something in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        let at = self.motion.origin;
        let (_, normal) = self.surface.distance_and_normal(&at);
        self.obstacle = Some(Placed::new(obstacle, at, normal));
    }

    /// All sensor records of the last period, oldest first.
    pub fn sensor_samples(&self) -> &[SensorSample] {
        self.sensor.records()
    }

    /// What the arm reports now.
    pub fn arm(&self) -> ArmMeasurement {
        ArmMeasurement {
            time_s: self.time_s(),
            q: self.servo.q_measured(),
            qd: self.servo.qd_measured(),
            q_target: self.servo.q_target,
            qd_target: self.servo.qd_target,
        }
    }

    /// What really happens at the contact now.
    pub fn truth(&self) -> Truth {
        let truth = Truth::of(
            self.time_s(),
            &self.surface,
            &self.motion,
            &self.contact,
            self.config.contact.friction.coulomb_coefficient,
        );
        match &self.platform {
            Some(platform) => truth.seen_from(&platform.pose(self.time_s())),
            None => truth,
        }
    }

    /// What the platform has published in the last period, oldest first.
    pub fn odometry(&self) -> &[OdometrySample] {
        self.platform.as_ref().map_or(&[], Platform::published)
    }

    /// Time since the plant was made, s.
    pub fn time_s(&self) -> f64 {
        self.periods as f64 * self.config.arm.period_s
    }

    /// Time per step, s.
    pub fn period_s(&self) -> f64 {
        self.config.arm.period_s
    }

    /// The configuration it was made from.
    pub fn config(&self) -> &PlantConfig {
        &self.config
    }

    /// The arm's model.
    pub fn model(&self) -> &Arm<6> {
        &self.arm
    }

    /// The surface, for drawing and for truth.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// `flange_from_tool` as configured; the tool's deflection is not in it.
    pub fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.flange_from_tool
    }

    /// `flange_from_sensor` as configured.
    pub fn flange_from_sensor(&self) -> Pose<Flange, SensorFrame> {
        self.load.flange_from_sensor()
    }

    /// True joint positions, rad.
    pub fn joints(&self) -> Joints<6> {
        self.servo.q
    }

    /// The sensor's present zero (N, Nm, sensor axes): what an ideal tare would remove.
    pub fn sensor_bias(&self) -> Wrench<SensorFrame> {
        Wrench::from_vector(&self.sensor.bias(self.time_s()))
    }

    /// Moves the arm to `q` (rad) at once, at rest: for a teleport between tests, never for motion.
    pub fn reset_joints(&mut self, q: &Joints<6>) {
        self.servo = Servo::new(&self.config.arm, self.arm.limits(), *q);
        let pose = *self.arm.base_from_flange(q).isometry();
        self.body = Body::at_rest(self.on_floor(pose, self.time_s()));
        let tool = self.body.pose * self.flange_from_tool.isometry();
        self.contact = PadContact::none();
        self.motion = PadMotion {
            origin: tool.translation.vector,
            rotation: tool.rotation,
            linear: Vector3::zeros(),
            angular: Vector3::zeros(),
        };
        let wrench = self.sensor_wrench(&self.body, &Vector3::zeros(), &Vector3::zeros());
        self.sensor.set_wrench(wrench);
    }
}

/// Rotation vector of a rotation far below a right angle, rad.
fn small_rotation(turn: &UnitQuaternion<f64>) -> Vector3<f64> {
    let v = turn.imag() * turn.w.signum();
    let length = v.norm();
    // asin(x)/x to second order: exact to 1e-16 for turns of a sub-step, and no division by zero.
    if length < 1e-3 {
        v * (2.0 + length * length / 3.0)
    } else {
        v * (2.0 * length.asin() / length)
    }
}

#[cfg(test)]
mod tests;
