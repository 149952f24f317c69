//! The arm that the controller moves: the simulated cell, or a bare arm for tests of the protocols.

use tangent_mechanics::{Arm, Base, Flange, Joints, ModelData, ModelError, Pose};
use tangent_simulation::{
    AdmittancePlant, ArmMeasurement, FlangeLoad, OdometrySample, SensorSample, Servo, ServoConfig,
    True, Truth, VelocityCommand,
};

/// An arm behind the controller, one control period per step.
pub trait ArmPlant: Send {
    /// Runs one period under `command`.
    fn step(&mut self, command: &VelocityCommand);
    /// Present measurements of the arm.
    fn arm(&self) -> ArmMeasurement;
    /// Records of the force/torque sensor in the last period.
    fn sensor_samples(&self) -> &[SensorSample];
    /// The truth about the contact, if there is a surface.
    fn truth(&self) -> Option<Truth>;
    /// Load on the flange, which the sensor of an e-Series arm measures.
    fn flange_load(&self) -> FlangeLoad {
        FlangeLoad::none()
    }
    /// Odometry of the platform under the arm in the last period.
    fn odometry(&self) -> &[OdometrySample] {
        &[]
    }
    /// True pose of the flange, if a camera on it has something to see.
    fn true_base_from_flange(&self) -> Option<True<Pose<Base, Flange>>> {
        None
    }
}

impl ArmPlant for AdmittancePlant {
    fn step(&mut self, command: &VelocityCommand) {
        AdmittancePlant::step(self, command);
    }

    fn arm(&self) -> ArmMeasurement {
        AdmittancePlant::arm(self)
    }

    fn sensor_samples(&self) -> &[SensorSample] {
        AdmittancePlant::sensor_samples(self)
    }

    fn truth(&self) -> Option<Truth> {
        Some(AdmittancePlant::truth(self))
    }

    fn flange_load(&self) -> FlangeLoad {
        AdmittancePlant::flange_load(self)
    }

    fn odometry(&self) -> &[OdometrySample] {
        AdmittancePlant::odometry(self)
    }

    fn true_base_from_flange(&self) -> Option<True<Pose<Base, Flange>>> {
        Some(AdmittancePlant::true_base_from_flange(self))
    }
}

/// An arm in free space, without a sensor.
#[derive(Debug)]
pub struct BareArm {
    servo: Servo,
    period_s: f64,
    time_s: f64,
}

impl BareArm {
    /// A built-in model at its home pose.
    ///
    /// # Errors
    /// The model is unknown.
    pub fn builtin(model: &str, servo: &ServoConfig) -> Result<Self, ModelError> {
        let arm = Arm::<6>::new(&ModelData::builtin(model)?)?;
        Ok(Self {
            servo: Servo::new(servo, arm.limits(), arm.home()),
            period_s: servo.period_s,
            time_s: 0.0,
        })
    }

    /// Joint positions, rad.
    pub fn joints(&self) -> Joints<6> {
        self.servo.q
    }
}

impl ArmPlant for BareArm {
    fn step(&mut self, command: &VelocityCommand) {
        let active = self.servo.exchange(command);
        for _ in 0..4 {
            self.servo.step(&active, self.period_s / 4.0);
        }
        self.time_s += self.period_s;
    }

    fn arm(&self) -> ArmMeasurement {
        ArmMeasurement {
            time_s: self.time_s,
            q: self.servo.q_measured(),
            qd: self.servo.qd_measured(),
            q_target: self.servo.q_target,
            qd_target: self.servo.qd_target,
        }
    }

    fn sensor_samples(&self) -> &[SensorSample] {
        &[]
    }

    fn truth(&self) -> Option<Truth> {
        None
    }
}
