//! Payload of the sensor: its weight, and its inertial wrench if the motion is known.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Sensor, Wrench};

use crate::SensingError;

/// Mass that the sensor carries: everything on its tool side.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_sensing::Payload;
///
/// let gripper = Payload {
///     mass_kg: 1.0,
///     com_in_sensor_m: [0.0, 0.0, 0.05],
///     ..Payload::default()
/// };
/// gripper.check()?;
/// // The sensor's z axis is horizontal: the weight bends it.
/// let weight = gripper.wrench(&Vector3::new(9.81, 0.0, 0.0), None);
/// assert_eq!(weight.force, Vector3::new(9.81, 0.0, 0.0));
/// assert!((weight.torque.y - 0.4905).abs() < 1e-12);
/// # Ok::<(), tangent_sensing::SensingError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Payload {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
    /// Principal inertia about the centre of mass along sensor axes, kg m²; used only if the motion
    /// is given.
    pub inertia_kg_m2: [f64; 3],
}

/// Motion of the sensor's body, in sensor axes.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_sensing::{Payload, SensorMotion};
///
/// // A payload that falls freely exerts no force on the sensor.
/// let gravity = Vector3::new(0.0, 0.0, -9.81);
/// let falling = SensorMotion {
///     acceleration: gravity,
///     angular_velocity: Vector3::zeros(),
///     angular_acceleration: Vector3::zeros(),
/// };
/// let payload = Payload { mass_kg: 2.0, ..Payload::default() };
/// assert_eq!(payload.wrench(&gravity, Some(&falling)).force, Vector3::zeros());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorMotion {
    /// Acceleration of the sensor's origin, without gravity, m/s².
    pub acceleration: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Angular acceleration, rad/s².
    pub angular_acceleration: Vector3<f64>,
}

impl Payload {
    /// Checks every number.
    ///
    /// # Errors
    /// The first number that is not finite or out of its range.
    pub fn check(&self) -> Result<(), SensingError> {
        SensingError::unless(
            (0.0..=200.0).contains(&self.mass_kg),
            "payload.mass_kg",
            self.mass_kg,
            "from 0 to 200",
        )?;
        for value in self.com_in_sensor_m {
            SensingError::unless(
                (-2.0..=2.0).contains(&value),
                "payload.com_in_sensor_m",
                value,
                "from -2 to 2",
            )?;
        }
        for value in self.inertia_kg_m2 {
            SensingError::unless(
                (0.0..=100.0).contains(&value),
                "payload.inertia_kg_m2",
                value,
                "from 0 to 100",
            )?;
        }
        Ok(())
    }

    /// Wrench of the payload on the sensor, given the acceleration of gravity in sensor axes
    /// (m/s²): its weight, and with `motion` its inertial wrench.
    pub fn wrench(
        &self,
        gravity_in_sensor: &Vector3<f64>,
        motion: Option<&SensorMotion>,
    ) -> Wrench<Sensor> {
        let com = Vector3::from(self.com_in_sensor_m);
        let Some(motion) = motion else {
            let force = gravity_in_sensor * self.mass_kg;
            return Wrench::new(force, com.cross(&force));
        };
        let spin = motion.angular_velocity;
        let com_acceleration = motion.acceleration
            + motion.angular_acceleration.cross(&com)
            + spin.cross(&spin.cross(&com));
        let force = (gravity_in_sensor - com_acceleration) * self.mass_kg;
        let inertia = Vector3::from(self.inertia_kg_m2);
        let turning = inertia.component_mul(&motion.angular_acceleration)
            + spin.cross(&inertia.component_mul(&spin));
        Wrench::new(force, com.cross(&force) - turning)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn payload() -> Payload {
        Payload {
            mass_kg: 0.5,
            com_in_sensor_m: [0.01, -0.02, 0.06],
            inertia_kg_m2: [4e-4, 5e-4, 1e-4],
        }
    }

    #[test]
    fn a_payload_in_free_fall_weighs_nothing() {
        let gravity = Vector3::new(1.0, -3.0, 9.0);
        let falling = SensorMotion {
            acceleration: gravity,
            angular_velocity: Vector3::zeros(),
            angular_acceleration: Vector3::zeros(),
        };
        let wrench = payload().wrench(&gravity, Some(&falling));
        assert!(wrench.vector().norm() < 1e-15);
    }

    #[test]
    fn a_payload_whirled_around_pulls_outwards() {
        let motion = SensorMotion {
            acceleration: Vector3::zeros(),
            angular_velocity: Vector3::new(0.0, 0.0, 10.0),
            angular_acceleration: Vector3::zeros(),
        };
        let wrench = payload().wrench(&Vector3::zeros(), Some(&motion));
        // m ω² r
        assert!((wrench.force - Vector3::new(0.5, -1.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn nonsense_is_refused() {
        for bad in [f64::NAN, -0.1, 1e9] {
            let payload = Payload {
                mass_kg: bad,
                ..payload()
            };
            assert!(payload.check().is_err());
        }
        assert!(payload().check().is_ok());
    }
}
