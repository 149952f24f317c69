//! The simulated cell of object-pose scenarios: a torque-controlled arm with a stick, a compliant
//! object, a force sensor and a camera on the wrist. It is stepped once per control period.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use tangent_estimation::{CORNERS, CameraFrame, CameraModel};
use tangent_mechanics::{Base, Flange, Joints, Object, Pose, Sensor as SensorFrame, Tool, Wrench};

use super::plant_config::{ObjectPlantConfig, check};
use crate::arms::loaded_arm::true_arm;
use crate::arms::measurement::ArmMeasurement;
use crate::arms::torque_arm::TorqueArm;
use crate::contact::{Obstacle, PadMotion};
use crate::hardware_errors::WrenchDistortion;
use crate::plant_error::PlantError;
use crate::sensors::camera::{Camera, Exposure, Imager};
use crate::sensors::load::{Body, SensorLoad};
use crate::sensors::records::SensorRecords;
use crate::sensors::sample::SensorSample;
use crate::start;
use crate::touch::Touch;
use crate::true_value::True;
use crate::truth::Truth;

/// The simulated cell.
pub struct ObjectPlant<const N: usize = 6> {
    config: ObjectPlantConfig,
    arm: TorqueArm<N>,
    touch: Touch,
    start_pose: Isometry3<f64>,
    corners: [Vector3<f64>; CORNERS],
    load: SensorLoad,
    sensor: SensorRecords,
    camera: Camera,
    flange_from_tool: True<Pose<Flange, Tool>>,
    dt: f64,
    periods: u64,
    body: Body,
    joint_wrench: Joints<N>,
    flange: Pose<Base, Flange>,
    torque_applied: Joints<N>,
}

impl<const N: usize> ObjectPlant<N> {
    /// Builds the cell at rest in its start pose, with the motors holding the arm. `corners` are
    /// those of the target, object axes, m.
    ///
    /// # Errors
    /// A key is wrong, with what is allowed, or the start pose cannot be reached, with the reason.
    pub fn new(
        config: &ObjectPlantConfig,
        corners: [Vector3<f64>; CORNERS],
        seed: u64,
    ) -> Result<Self, PlantError> {
        check(config)?;
        let config = config.drawn(N, seed);
        let errors = &config.errors;
        let model = *true_arm::<N>(&config.robot, &config.tool)?.to_compare();
        let mut touch = Touch::new(&config.surface, &config.tool, &config.contact)?;
        if let Some(variation) = errors.friction {
            touch.vary_friction(variation);
        }
        let flange_from_tool = errors.frames.flange_from_tool(&config.tool);
        let target = start::tool_pose(&config.start, &touch.surface);
        let q = start::joints(&model, &flange_from_tool, &target, &config.start)?;
        touch.place_tool(&target);
        let gravity = model.gravity(&q);
        let flange = model.base_from_flange(&q);
        let mut plant = Self {
            arm: TorqueArm::new(model, &config.arm, q).with_errors(&config.arm, &errors.arm),
            touch,
            start_pose: config.surface.pose().isometry(),
            corners,
            load: SensorLoad::new(&config.tool)
                .with_sensor_at(errors.frames.flange_from_sensor(&config.tool)),
            sensor: SensorRecords::new(&config.sensor, config.arm.period_s, seed, Vector6::zeros()),
            camera: Camera::new(&config.camera, seed)?,
            flange_from_tool: True::new(flange_from_tool),
            dt: config.arm.period_s / config.arm.sub_steps as f64,
            periods: 0,
            body: Body::at_rest(*flange.isometry()),
            joint_wrench: Joints::<N>::zeros(),
            flange,
            torque_applied: gravity,
            config,
        };
        let zero = Vector3::zeros();
        let wrench = plant.load.wrench(
            &plant.body,
            &zero,
            &zero,
            &plant.touch.contact,
            &plant.touch.motion.origin,
        );
        plant.sensor.set_wrench(wrench);
        let (errors, rate_hz) = (&plant.config.errors.wrench, plant.config.sensor.rate_hz);
        let distortion = WrenchDistortion::new(errors, rate_hz, seed, &wrench);
        plant.sensor.distort_with(distortion);
        plant.expose();
        Ok(plant)
    }

    /// Runs one period under motor torques (Nm): from their delay line to the sensor's samples and
    /// the camera.
    pub fn step(&mut self, torque: &Joints<N>) {
        self.sensor.clear();
        let active = self.arm.exchange(torque);
        self.torque_applied = self.arm.limited(&active);
        let start = self.time_s();
        for sub_step in 0..self.config.arm.sub_steps {
            self.sub_step(&active, start + sub_step as f64 * self.dt);
        }
        self.periods += 1;
        self.expose();
    }

    fn sub_step(&mut self, torque: &Joints<N>, time_before: f64) {
        let dt = self.dt;
        self.arm.step(torque, &self.joint_wrench, dt);
        let time = time_before + dt;
        let object = &self.config.object;
        if object.velocity_m_per_s != [0.0; 3] || object.turn_rate_rad_per_s != [0.0; 3] {
            self.touch.surface.place(&self.rest_isometry(time));
        }
        let model = *self.arm.model();
        let (q, qd) = (self.arm.q, self.arm.qd);
        let (tool, jacobian) = model.tool_and_jacobian(&q, self.flange_from_tool.to_compare());
        let twist = jacobian * qd;
        let motion = PadMotion::moving(&tool, &twist);
        self.touch.step(motion, dt);
        self.joint_wrench = jacobian.tr_mul(&self.touch.contact.wrench());

        self.flange = tool * self.flange_from_tool.to_compare().inverse();
        let lever = tool.translation() - self.flange.translation();
        let body = Body {
            pose: *self.flange.isometry(),
            linear: motion.linear - motion.angular.cross(&lever),
            angular: motion.angular,
        };
        let acceleration = (body.linear - self.body.linear) / dt;
        let angular_acceleration = (body.angular - self.body.angular) / dt;
        self.body = body;
        let wrench = self.load.wrench(
            &body,
            &acceleration,
            &angular_acceleration,
            &self.touch.contact,
            &self.touch.motion.origin,
        );
        self.sensor.set_speed(self.body.linear.norm());
        self.sensor.advance(time_before, dt, wrench);
    }

    /// Puts an obstacle in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.touch.put_in_the_way(obstacle);
    }

    fn expose(&mut self) {
        let (time, flange, object) = (self.time_s(), self.flange, self.base_from_object());
        self.camera.expose(time, &flange, &object, &self.corners);
    }

    fn rest_isometry(&self, time_s: f64) -> Isometry3<f64> {
        let object = &self.config.object;
        let moved = Vector3::from(object.velocity_m_per_s) * time_s;
        let turned =
            UnitQuaternion::from_scaled_axis(Vector3::from(object.turn_rate_rad_per_s) * time_s);
        Isometry3::from_parts(
            Translation3::from(self.start_pose.translation.vector + moved),
            turned * self.start_pose.rotation,
        )
    }

    /// Current pose of the object without its deflection under the tool.
    pub fn base_from_object_rest(&self) -> Pose<Base, Object> {
        Pose::from_isometry(self.rest_isometry(self.time_s()))
    }

    /// Current pose of the object, including its deflection along the normal under the tool.
    pub fn base_from_object(&self) -> Pose<Base, Object> {
        let rest = self.base_from_object_rest();
        if !self.config.object.yields || self.touch.contact.depth <= 0.0 {
            return rest;
        }
        Pose::new(
            rest.translation() - self.touch.normal() * self.touch.contact.depth,
            rest.rotation(),
        )
    }

    /// All sensor records of the last period, oldest first.
    pub fn sensor_samples(&self) -> &[SensorSample] {
        self.sensor.records()
    }

    /// The oldest frame of the camera that has arrived and has not been taken.
    pub fn take_frame(&mut self) -> Option<CameraFrame> {
        let time = self.time_s();
        self.camera.take(time)
    }

    /// Hands the rendering of the camera's images over to the returned [`Imager`], which takes its
    /// input from [`ObjectPlant::take_exposure`].
    pub fn hand_over_camera(&mut self) -> Imager {
        self.camera.hand_over(self.corners)
    }

    /// The camera's newest exposure, unless it has been taken already.
    pub fn take_exposure(&mut self) -> Option<Exposure> {
        self.camera.take_exposure()
    }

    /// Current measurements of the arm; without a servo, the targets equal the measured values.
    pub fn arm(&self) -> ArmMeasurement<N> {
        let (q, qd) = (self.arm.q_measured(), self.arm.qd_measured());
        ArmMeasurement {
            time_s: self.time_s(),
            q,
            qd,
            q_target: q,
            qd_target: qd,
        }
    }

    /// Current true state of the contact.
    pub fn truth(&self) -> Truth {
        self.touch.truth(self.time_s())
    }

    /// True wrench on the sensor, N and Nm, sensor axes.
    pub fn sensor_wrench(&self) -> Wrench<SensorFrame> {
        Wrench::from_vector(&self.sensor.wrench())
    }

    /// Time since the plant was created, s.
    pub fn time_s(&self) -> f64 {
        self.periods as f64 * self.config.arm.period_s
    }

    /// Time per step, s.
    pub fn period_s(&self) -> f64 {
        self.config.arm.period_s
    }

    /// `flange_from_tool` as stated.
    pub fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        Pose::from_isometry(self.config.tool.flange_from_tool.isometry())
    }

    /// `flange_from_sensor` as stated.
    pub fn flange_from_sensor(&self) -> Pose<Flange, SensorFrame> {
        Pose::from_isometry(self.config.tool.flange_from_sensor.isometry())
    }

    /// True pose of the tool on the flange.
    pub fn true_flange_from_tool(&self) -> True<Pose<Flange, Tool>> {
        self.flange_from_tool
    }

    /// The camera's true calibration.
    pub fn camera_truth(&self) -> True<CameraModel> {
        self.camera.truth()
    }

    /// Motor torques of the last period, Nm.
    pub fn torque_applied(&self) -> Joints<N> {
        self.torque_applied
    }
}
