//! What hangs on the sensor: its weight, and its inertia where the motion is known.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Sensor, Wrench};

use crate::SensingError;

/// Mass carried by the sensor (everything on its tool side).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Payload {
    /// kg
    pub mass_kg: f64,
    /// Centre of mass, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
    /// Principal inertia about the centre of mass along sensor axes, kg m²; used only where the
    /// motion is given.
    pub inertia_kg_m2: [f64; 3],
}

/// How the sensor's body moves, in sensor axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorMotion {
    /// Of the sensor's origin, without gravity, m/s².
    pub acceleration: Vector3<f64>,
    /// rad/s
    pub angular_velocity: Vector3<f64>,
    /// rad/s²
    pub angular_acceleration: Vector3<f64>,
}

impl Payload {
    /// # Errors
    /// A number that is not finite, or negative where that makes no sense.
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

    /// What the payload alone does to the sensor, given the acceleration of gravity in sensor axes
    /// (m/s²): weight, and with `motion` d'Alembert's forces.
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
