//! Load on the sensor: the contact's wrench, and weight and inertia of everything on its tool side.

use nalgebra::{Isometry3, Vector3, Vector6};
use tangent_mechanics::{Flange, Pose, Sensor as SensorFrame, Wrench};

use crate::contact::PadContact;
use crate::tool::ToolConfig;

/// Standard gravity, m/s², along minus z of the base.
const GRAVITY_M_PER_S2: f64 = 9.80665;

/// Motion of the flange at the end of a sub-step, in floor axes: the axes of the base at time zero,
/// in which the surface is fixed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Body {
    pub pose: Isometry3<f64>,
    /// Velocity of the flange's origin, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular: Vector3<f64>,
}

impl Body {
    pub fn at_rest(pose: Isometry3<f64>) -> Self {
        Self {
            pose,
            linear: Vector3::zeros(),
            angular: Vector3::zeros(),
        }
    }
}

/// Load on the flange, at its origin and in its axes, N and Nm; without inertial forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangeLoad {
    /// What the surface does to the tool.
    pub contact: Wrench<Flange>,
    /// Weight of tool and sensor.
    pub weight: Wrench<Flange>,
}

impl FlangeLoad {
    /// No load.
    pub fn none() -> Self {
        Self {
            contact: Wrench::zero(),
            weight: Wrench::zero(),
        }
    }
}

/// True payload of the sensor.
#[derive(Clone, Debug)]
pub(crate) struct SensorLoad {
    flange_from_sensor: Pose<Flange, SensorFrame>,
    mass: f64,
    com: Vector3<f64>,
    inertia: Vector3<f64>,
}

impl SensorLoad {
    pub fn new(tool: &ToolConfig) -> Self {
        let (payload, error) = (&tool.payload, &tool.payload_error);
        Self {
            flange_from_sensor: Pose::from_isometry(tool.flange_from_sensor.isometry()),
            mass: payload.mass_kg + error.mass_kg,
            com: Vector3::from(payload.com_in_sensor_m) + Vector3::from(error.com_in_sensor_m),
            inertia: Vector3::from(payload.inertia_kg_m2),
        }
    }

    /// The payload on a sensor that is mounted differently from what `tool` states: the payload
    /// itself stays where it is.
    pub fn with_sensor_at(self, flange_from_sensor: Pose<Flange, SensorFrame>) -> Self {
        if flange_from_sensor == self.flange_from_sensor {
            return self;
        }
        let stated_from_true = self.flange_from_sensor.inverse() * flange_from_sensor;
        let com = stated_from_true
            .isometry()
            .inverse_transform_point(&self.com.into());
        Self {
            com: com.coords,
            flange_from_sensor,
            ..self
        }
    }

    /// Load on the flange while the arm is at rest in `pose`, floor axes.
    pub fn on_flange(
        &self,
        pose: Isometry3<f64>,
        contact: &PadContact,
        contact_at: &Vector3<f64>,
    ) -> FlangeLoad {
        let body = Body::at_rest(pose);
        let still = Vector3::zeros();
        let at_sensor = |contact: &PadContact| {
            let wrench = self.wrench(&body, &still, &still, contact, contact_at);
            Wrench::<SensorFrame>::from_vector(&wrench)
        };
        let (all, weight) = (at_sensor(contact), at_sensor(&PadContact::none()));
        let contact = Wrench::from_vector(&(all.vector() - weight.vector()));
        FlangeLoad {
            contact: self.flange_from_sensor.transform_wrench(&contact),
            weight: self.flange_from_sensor.transform_wrench(&weight),
        }
    }

    /// Wrench of contact (at `contact_at`, base axes, m), gravity and inertia of the payload on the
    /// sensor: N and Nm, sensor axes. Accelerations are those of the flange's origin, base axes.
    pub fn wrench(
        &self,
        body: &Body,
        acceleration: &Vector3<f64>,
        angular_acceleration: &Vector3<f64>,
        contact: &PadContact,
        contact_at: &Vector3<f64>,
    ) -> Vector6<f64> {
        let sensor = body.pose * self.flange_from_sensor.isometry();
        let back = |v: Vector3<f64>| sensor.rotation.inverse_transform_vector(&v);
        let origin = sensor.translation.vector;

        let (force, at) = (contact.force, contact_at);
        let contact_torque = contact.torque + (at - origin).cross(&force);

        let com = origin + sensor.rotation * self.com;
        let lever = com - body.pose.translation.vector;
        let com_acceleration = acceleration
            + angular_acceleration.cross(&lever)
            + body.angular.cross(&body.angular.cross(&lever));
        let weight = Vector3::new(0.0, 0.0, -self.mass * GRAVITY_M_PER_S2);
        let load = weight - com_acceleration * self.mass;
        let spin = back(body.angular);
        let gyroscopic = self.inertia.component_mul(&back(*angular_acceleration))
            + spin.cross(&self.inertia.component_mul(&spin));

        let f = back(force + load);
        let t = back(contact_torque + (com - origin).cross(&load)) - gyroscopic;
        Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z)
    }
}
