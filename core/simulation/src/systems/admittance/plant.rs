//! The simulated cell: arm, tool, surface and sensor, one arm period per step. Driven by the live
//! simulator and by `evaluate`.

use nalgebra::{Isometry3, UnitQuaternion, Vector3, Vector6};
use tangent_mechanics::{
    Arm, Base, Flange, Joints, ModelData, Pose, Sensor as SensorFrame, Tool, Wrench,
};

use super::check::check;
use super::plant_config::AdmittancePlantConfig;
use crate::arms::measurement::{ArmMeasurement, VelocityCommand};
use crate::arms::platform::{OdometrySample, Platform};
use crate::arms::servo::Servo;
use crate::contact::{Obstacle, PadMotion};
use crate::hardware_errors::wrench_errors::cable_pull;
use crate::hardware_errors::{ArmSenses, WrenchDistortion};
use crate::plant_error::PlantError;
use crate::sensors::arm_force::ArmForce;
use crate::sensors::load::{Body, FlangeLoad, SensorLoad};
use crate::sensors::records::SensorRecords;
use crate::sensors::sample::SensorSample;
use crate::start;
use crate::surfaces::Surface;
use crate::touch::Touch;
use crate::true_value::True;
use crate::truth::Truth;

/// The simulated cell.
#[derive(Clone, Debug)]
pub struct AdmittancePlant {
    config: AdmittancePlantConfig,
    arm: Arm<6>,
    servo: Servo,
    touch: Touch,
    sensor: SensorRecords,
    arm_force: ArmForce,
    platform: Option<Platform>,
    /// As stated.
    flange_from_tool: Pose<Flange, Tool>,
    true_flange_from_tool: Pose<Flange, Tool>,
    load: SensorLoad,
    senses: Option<ArmSenses>,
    /// Measured joint positions (rad) and velocities (rad/s).
    measured: (Joints<6>, Joints<6>),
    /// Joint positions at the start, where the cable does not pull, rad.
    cable_at: Joints<6>,
    sub_steps: usize,
    dt: f64,
    periods: u64,
    body: Body,
}

impl AdmittancePlant {
    /// Builds the cell at rest in its start pose. Equal configuration and seed give equal bits in
    /// all later steps.
    ///
    /// # Errors
    /// A key is wrong, with what is allowed, or the start pose cannot be reached, with the reason.
    pub fn new(config: &AdmittancePlantConfig, seed: u64) -> Result<Self, PlantError> {
        check(config)?;
        let arm = Arm::<6>::new(&ModelData::builtin(&config.robot)?)?;
        let mut touch = Touch::new(&config.surface, &config.tool, &config.contact)?;
        let flange_from_tool = Pose::from_isometry(config.tool.flange_from_tool.isometry());
        let errors = &config.errors;
        let true_flange_from_tool = errors.frames.flange_from_tool(&config.tool);
        let target = start::tool_pose(&config.start, &touch.surface);
        let q = start::joints(&arm, &true_flange_from_tool, &target, &config.start)?;
        touch.place_tool(&target);
        if let Some(variation) = errors.friction {
            touch.vary_friction(variation);
        }

        let sub_steps = (config.arm.period_s / config.substep_max_s - 1e-9)
            .ceil()
            .max(1.0) as usize;
        let mut plant = Self {
            servo: servo(config, &arm, q),
            sensor: SensorRecords::new(&config.sensor, config.arm.period_s, seed, Vector6::zeros()),
            arm_force: ArmForce::new(&config.arm_force, seed),
            load: SensorLoad::new(&config.tool)
                .with_sensor_at(errors.frames.flange_from_sensor(&config.tool)),
            senses: ArmSenses::new(&errors.arm, seed),
            measured: (q, Joints::<6>::zeros()),
            cable_at: q,
            platform: config.base.as_ref().map(|base| Platform::new(base, seed)),
            dt: config.arm.period_s / sub_steps as f64,
            sub_steps,
            periods: 0,
            body: Body::at_rest(*arm.base_from_flange(&q).isometry()),
            config: config.clone(),
            arm,
            touch,
            flange_from_tool,
            true_flange_from_tool,
        };
        let wrench = plant.sensor_wrench(&plant.body, &Vector3::zeros(), &Vector3::zeros());
        plant.sensor.set_wrench(wrench);
        let (errors, rate_hz) = (&config.errors.wrench, config.sensor.rate_hz);
        plant
            .sensor
            .distort_with(WrenchDistortion::new(errors, rate_hz, seed, &wrench));
        plant.measure();
        Ok(plant)
    }

    /// Runs one arm period under `command`: from its delay line to the sensor's samples.
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
        self.measure();
        let load = self.flange_load().contact.force;
        let velocity = self.body.pose.rotation.inverse() * self.body.linear;
        self.arm_force.measure(&load, &velocity);
    }

    /// Encoders and velocity measurement read the joints.
    fn measure(&mut self) {
        self.measured = match &mut self.senses {
            None => (self.servo.q_measured(), self.servo.qd_measured()),
            Some(senses) => {
                let (q, qd) = senses.measure(&self.servo.q, &self.servo.qd);
                (self.servo.in_counts(&q), self.servo.in_velocity_counts(&qd))
            }
        };
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

        let lever = pose.rotation * self.true_flange_from_tool.translation();
        let rigid = PadMotion {
            origin: pose.translation.vector + lever,
            rotation: pose.rotation * self.true_flange_from_tool.rotation(),
            linear: body.linear + body.angular.cross(&lever),
            angular: body.angular,
        };
        self.touch.step(rigid, dt);
        self.body = body;
        let wrench = self.sensor_wrench(&body, &acceleration, &angular_acceleration);
        self.sensor.set_speed(body.linear.norm());
        self.sensor.advance(time_before, dt, wrench);
    }

    /// Contact, gravity and inertia of the payload on the sensor, N and Nm, sensor axes.
    fn sensor_wrench(
        &self,
        body: &Body,
        acceleration: &Vector3<f64>,
        angular_acceleration: &Vector3<f64>,
    ) -> Vector6<f64> {
        let mut wrench = self.load.wrench(
            body,
            acceleration,
            angular_acceleration,
            &self.touch.contact,
            &self.touch.motion.origin,
        );
        let errors = &self.config.errors.wrench;
        if errors.cable_n_per_rad > 0.0 {
            let turned = (self.servo.q - self.cable_at)
                .fixed_rows::<3>(3)
                .into_owned();
            wrench += cable_pull(errors, &turned);
        }
        wrench
    }

    /// Load on the flange by contact and payload, without inertial forces.
    pub fn flange_load(&self) -> FlangeLoad {
        let touch = &self.touch;
        self.load
            .on_flange(self.body.pose, &touch.contact, &touch.motion.origin)
    }

    /// Puts an obstacle in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.touch.put_in_the_way(obstacle);
    }

    /// Pushes on the tool's origin with a force (base axes, N) from now on, as a person's hand
    /// does.
    pub fn push_by_hand(&mut self, force: Vector3<f64>) {
        self.touch.push_by_hand(force);
    }

    /// All sensor records of the last period, oldest first.
    pub fn sensor_samples(&self) -> &[SensorSample] {
        self.sensor.records()
    }

    /// Current measurements of the arm.
    pub fn arm(&self) -> ArmMeasurement {
        ArmMeasurement {
            time_s: self.time_s(),
            q: self.measured.0,
            qd: self.measured.1,
            q_target: self.servo.q_target,
            qd_target: self.servo.qd_target,
        }
    }

    /// Force on the flange as the arm's own controller states it, without the weight of the tool,
    /// flange axes, N; `None` if it states none.
    pub fn arm_force(&self) -> Option<Vector3<f64>> {
        self.arm_force.now()
    }

    /// Current true state of the contact.
    pub fn truth(&self) -> Truth {
        let truth = self.touch.truth(self.time_s());
        match &self.platform {
            Some(platform) => truth.seen_from(&platform.pose(self.time_s())),
            None => truth,
        }
    }

    /// Poses that the platform has published in the last period, oldest first.
    pub fn odometry(&self) -> &[OdometrySample] {
        self.platform.as_ref().map_or(&[], Platform::published)
    }

    /// Time since the plant was created, s.
    pub fn time_s(&self) -> f64 {
        self.periods as f64 * self.config.arm.period_s
    }

    /// Time per step, s.
    pub fn period_s(&self) -> f64 {
        self.config.arm.period_s
    }

    /// Configuration that the plant was built from.
    pub fn config(&self) -> &AdmittancePlantConfig {
        &self.config
    }

    /// The arm's model.
    pub fn model(&self) -> &Arm<6> {
        &self.arm
    }

    /// The surface under the tool.
    pub fn surface(&self) -> &Surface {
        &self.touch.surface
    }

    /// `flange_from_tool` as stated; the tool's deflection and its error are not in it.
    pub fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.flange_from_tool
    }

    /// True pose of the tool on the flange, without the tool's deflection.
    pub fn true_flange_from_tool(&self) -> True<Pose<Flange, Tool>> {
        True::new(self.true_flange_from_tool)
    }

    /// `flange_from_sensor` as stated.
    pub fn flange_from_sensor(&self) -> Pose<Flange, SensorFrame> {
        Pose::from_isometry(self.config.tool.flange_from_sensor.isometry())
    }

    /// True joint positions, rad.
    pub fn joints(&self) -> Joints<6> {
        self.servo.q
    }

    /// True pose of the flange: where a camera on it is, whatever the encoders measure.
    pub fn true_base_from_flange(&self) -> True<Pose<Base, Flange>> {
        True::new(self.arm.base_from_flange(&self.servo.q))
    }

    /// Current zero of the sensor (N, Nm, sensor axes): what an ideal tare would remove.
    pub fn sensor_bias(&self) -> Wrench<SensorFrame> {
        Wrench::from_vector(&self.sensor.bias(self.time_s()))
    }

    /// Moves the arm to `q` (rad) at once, at rest: only to reset it between tests, never as a
    /// motion.
    pub fn reset_joints(&mut self, q: &Joints<6>) {
        self.servo = servo(&self.config, &self.arm, *q);
        let pose = *self.arm.base_from_flange(q).isometry();
        self.body = Body::at_rest(self.on_floor(pose, self.time_s()));
        let tool = self.body.pose * self.true_flange_from_tool.isometry();
        self.touch.place_tool(&Pose::from_isometry(tool));
        let wrench = self.sensor_wrench(&self.body, &Vector3::zeros(), &Vector3::zeros());
        self.sensor.set_wrench(wrench);
        self.measure();
    }
}

/// Servo at rest at `q` (rad), with the joints' true bandwidths.
fn servo(config: &AdmittancePlantConfig, arm: &Arm<6>, q: Joints<6>) -> Servo {
    Servo::new(&config.arm, arm.limits(), q).with_bandwidth_ratio(config.errors.arm.bandwidth_ratio)
}

/// Rotation vector of a rotation far below a right angle, rad.
fn small_rotation(turn: &UnitQuaternion<f64>) -> Vector3<f64> {
    let v = turn.imag() * turn.w.signum();
    let length = v.norm();
    // asin(x)/x to second order: exact to 1e-16 for the rotation in a sub-step, without a division
    // by zero.
    if length < 1e-3 {
        v * (2.0 + length * length / 3.0)
    } else {
        v * (2.0 * length.asin() / length)
    }
}

#[cfg(test)]
mod tests;
