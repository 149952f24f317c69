//! The simulated cell of object-pose scenarios: a torque-controlled arm with a stick, an object
//! that yields, a force sensor and a camera on the wrist. One control period per step.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use tangent_estimation::{CORNERS, CameraFrame, CameraModel};
use tangent_mechanics::{
    Arm, Base, Flange, JointFriction, Joints, Object, Pose, Sensor as SensorFrame, Tool, Wrench,
};

use crate::camera::{Camera, Exposure, Imager};
use crate::contact::{Pad, PadContact, PadMotion};
use crate::loaded_arm::loaded_arm;
use crate::measurement::{ArmMeasurement, SensorSample};
use crate::object_plant_config::{ObjectPlantConfig, check};
use crate::obstacle::{Obstacle, Placed};
use crate::plant_error::PlantError;
use crate::pose_config::PoseConfig;
use crate::sensor_load::{Body, SensorLoad};
use crate::sensor_records::SensorRecords;
use crate::start;
use crate::surfaces::Surface;
use crate::torque_arm::{DELAY_PERIODS_MAX, TorqueArm};
use crate::truth::Truth;

/// The simulated cell.
pub struct ObjectPlant {
    config: ObjectPlantConfig,
    arm: TorqueArm<6>,
    surface: Surface,
    start_pose: Isometry3<f64>,
    corners: [Vector3<f64>; CORNERS],
    pad: Pad,
    load: SensorLoad,
    sensor: SensorRecords,
    camera: Camera,
    flange_from_tool: Pose<Flange, Tool>,
    dt: f64,
    periods: u64,
    torques: [Joints<6>; DELAY_PERIODS_MAX + 1],
    body: Body,
    motion: PadMotion,
    contact: PadContact,
    obstacle: Option<Placed>,
    joint_wrench: Joints<6>,
    flange: Pose<Base, Flange>,
    torque_applied: Joints<6>,
}

impl ObjectPlant {
    /// Builds the cell at rest in its start pose, motors holding the arm. `corners` are the
    /// target's, object axes, m.
    ///
    /// # Errors
    /// Says which key is wrong and what is allowed, or why the start pose cannot be reached.
    pub fn new(
        config: &ObjectPlantConfig,
        corners: [Vector3<f64>; CORNERS],
        seed: u64,
    ) -> Result<Self, PlantError> {
        check(config)?;
        let model = loaded_arm::<6>(&config.robot, &config.tool, true)?;
        let surface_pose = PoseConfig {
            position_m: config.surface.position_m,
            roll_pitch_yaw_rad: config.surface.roll_pitch_yaw_rad,
        };
        let surface = Surface::new(&config.surface.shape, &surface_pose)?;
        let flange_from_tool = Pose::from_isometry(config.tool.flange_from_tool.isometry());
        let target = start::tool_pose(&config.start, &surface);
        let q = start::joints(&model, &flange_from_tool, &target, &config.start)?;
        let gravity = model.gravity(&q);
        let flange = model.base_from_flange(&q);
        let mut plant = Self {
            arm: TorqueArm::new(model, &config.arm, q),
            surface,
            start_pose: surface_pose.isometry(),
            corners,
            pad: Pad::new(
                &config.tool.pad,
                &config.contact,
                config.contact.stiffness_n_per_m,
            ),
            load: SensorLoad::new(&config.tool),
            sensor: SensorRecords::new(&config.sensor, config.arm.period_s, seed, Vector6::zeros()),
            camera: Camera::new(&config.camera, seed)?,
            flange_from_tool,
            dt: config.arm.period_s / config.arm.sub_steps as f64,
            periods: 0,
            torques: [gravity; DELAY_PERIODS_MAX + 1],
            body: Body::at_rest(*flange.isometry()),
            motion: PadMotion {
                origin: target.translation(),
                rotation: target.rotation(),
                linear: Vector3::zeros(),
                angular: Vector3::zeros(),
            },
            contact: PadContact::none(),
            obstacle: None,
            joint_wrench: Joints::<6>::zeros(),
            flange,
            torque_applied: gravity,
            config: config.clone(),
        };
        let zero = Vector3::zeros();
        let wrench = plant.load.wrench(
            &plant.body,
            &zero,
            &zero,
            &plant.contact,
            &plant.motion.origin,
        );
        plant.sensor.set_wrench(wrench);
        plant.expose();
        Ok(plant)
    }

    /// One period under motor torques (Nm), from their delay line to the sensor's samples and the
    /// camera.
    pub fn step(&mut self, torque: &Joints<6>) {
        self.sensor.clear();
        let delay = self.config.arm.delay_periods;
        self.torques[..=delay].rotate_right(1);
        self.torques[0] = *torque;
        let active = self.torques[delay];
        self.torque_applied = self.arm.limited(&active);
        let start = self.time_s();
        for sub_step in 0..self.config.arm.sub_steps {
            self.sub_step(&active, start + sub_step as f64 * self.dt);
        }
        self.periods += 1;
        self.expose();
    }

    fn sub_step(&mut self, torque: &Joints<6>, time_before: f64) {
        let dt = self.dt;
        self.arm.step(torque, &self.joint_wrench, dt);
        let time = time_before + dt;
        let object = &self.config.object;
        if object.velocity_m_per_s != [0.0; 3] || object.turn_rate_rad_per_s != [0.0; 3] {
            self.surface.place(&self.rest_isometry(time));
        }
        let model = *self.arm.model();
        let (q, qd) = (self.arm.q, self.arm.qd);
        let (tool, jacobian) = model.tool_and_jacobian(&q, &self.flange_from_tool);
        let twist = jacobian * qd;
        self.motion = PadMotion {
            origin: tool.translation(),
            rotation: tool.rotation(),
            linear: twist.fixed_rows::<3>(0).into_owned(),
            angular: twist.fixed_rows::<3>(3).into_owned(),
        };
        self.contact = self.pad.step(&self.surface, &self.motion, dt, None);
        if let Some(obstacle) = &self.obstacle {
            obstacle.push(&self.motion.origin, &mut self.contact);
        }
        let (f, t) = (&self.contact.force, &self.contact.torque);
        self.joint_wrench = jacobian.tr_mul(&Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z));

        self.flange = tool * self.flange_from_tool.inverse();
        let lever = tool.translation() - self.flange.translation();
        let body = Body {
            pose: *self.flange.isometry(),
            linear: self.motion.linear - self.motion.angular.cross(&lever),
            angular: self.motion.angular,
        };
        let acceleration = (body.linear - self.body.linear) / dt;
        let angular_acceleration = (body.angular - self.body.angular) / dt;
        self.body = body;
        let wrench = self.load.wrench(
            &body,
            &acceleration,
            &angular_acceleration,
            &self.contact,
            &self.motion.origin,
        );
        self.sensor.advance(time_before, dt, wrench);
    }

    /// Puts something in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        let at = self.motion.origin;
        let (_, normal) = self.surface.distance_and_normal(&at);
        self.obstacle = Some(Placed::new(obstacle, at, normal));
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

    /// Where the object would stand now if nothing pressed on it.
    pub fn base_from_object_rest(&self) -> Pose<Base, Object> {
        Pose::from_isometry(self.rest_isometry(self.time_s()))
    }

    /// Where the object stands now: given way along the normal under the tool.
    pub fn base_from_object(&self) -> Pose<Base, Object> {
        let rest = self.base_from_object_rest();
        if !self.config.object.yields || self.contact.depth <= 0.0 {
            return rest;
        }
        let (_, normal) = self.surface.distance_and_normal(&self.motion.origin);
        Pose::new(
            rest.translation() - normal * self.contact.depth,
            rest.rotation(),
        )
    }

    /// All sensor records of the last period, oldest first.
    pub fn sensor_samples(&self) -> &[SensorSample] {
        self.sensor.records()
    }

    /// The camera's next frame that has arrived, oldest first.
    pub fn take_frame(&mut self) -> Option<CameraFrame> {
        let time = self.time_s();
        self.camera.take(time)
    }

    /// From now on the camera's images are drawn by the one returned, from
    /// [`ObjectPlant::take_exposure`].
    pub fn hand_over_camera(&mut self) -> Imager {
        self.camera.hand_over(self.corners)
    }

    /// The camera's newest exposure that has not been taken.
    pub fn take_exposure(&mut self) -> Option<Exposure> {
        self.camera.take_exposure()
    }

    /// What the arm reports now; targets are what it measures, there is no servo.
    pub fn arm(&self) -> ArmMeasurement {
        let (q, qd) = (self.arm.q_measured(), self.arm.qd_measured());
        ArmMeasurement {
            time_s: self.time_s(),
            q,
            qd,
            q_target: q,
            qd_target: qd,
        }
    }

    /// What really happens at the contact now.
    pub fn truth(&self) -> Truth {
        Truth::of(
            self.time_s(),
            &self.surface,
            &self.motion,
            &self.contact,
            self.config.contact.friction.coulomb_coefficient,
        )
    }

    /// True wrench on the sensor, N and Nm, sensor axes.
    pub fn sensor_wrench(&self) -> Wrench<SensorFrame> {
        Wrench::from_vector(&self.sensor.wrench())
    }

    /// Time since the plant was made, s.
    pub fn time_s(&self) -> f64 {
        self.periods as f64 * self.config.arm.period_s
    }

    /// Time per step, s.
    pub fn period_s(&self) -> f64 {
        self.config.arm.period_s
    }

    /// The arm's model, with what hangs on it.
    pub fn model(&self) -> &Arm<6> {
        self.arm.model()
    }

    /// The joints' true friction.
    pub fn friction(&self) -> JointFriction<6> {
        self.config.arm.friction()
    }

    /// `flange_from_tool` as configured.
    pub fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.flange_from_tool
    }

    /// `flange_from_sensor` as configured.
    pub fn flange_from_sensor(&self) -> Pose<Flange, SensorFrame> {
        self.load.flange_from_sensor()
    }

    /// The camera's true calibration.
    pub fn camera_truth(&self) -> &CameraModel {
        self.camera.truth()
    }

    /// What the motors gave in the last period, Nm.
    pub fn torque_applied(&self) -> Joints<6> {
        self.torque_applied
    }
}
