//! Motion of the force sensor from the arm's measured velocities, for the inertia of its payload.
//!
//! Called with every state of the arm, before the readings that follow it are conditioned.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Base, Pose, Sensor, Tool, Twist};

use crate::SensorMotion;

/// Longest time between two states of the arm whose difference is an acceleration, s.
const SPAN_MAX_S: f64 = 0.02;

/// Velocity of the sensor in the last state of the arm. A new one is the reset.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_mechanics::{Pose, Twist};
/// use tangent_sensing::SensorMotionState;
///
/// let mut state = SensorMotionState::default();
/// let falls = |speed: f64| Twist::new(Vector3::new(0.0, 0.0, -speed), Vector3::zeros());
/// let at = Pose::identity();
/// assert!(state.update(0.000, &at, &Pose::identity(), &falls(0.00)).is_none());
/// let motion = state.update(0.001, &at, &Pose::identity(), &falls(0.01)).unwrap();
/// assert!((motion.acceleration.z + 10.0).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorMotionState {
    /// Time (s), linear velocity (m/s) and angular velocity (rad/s) of the sensor, base axes.
    last: Option<(f64, Vector3<f64>, Vector3<f64>)>,
}

impl SensorMotionState {
    /// Motion of the sensor's body between the last state of the arm and this one, in sensor axes.
    /// `twist` is that of the tool's origin. `None` for the first state, after a gap, and if a
    /// number is not finite: only the payload's weight can be compensated then.
    pub fn update(
        &mut self,
        time_s: f64,
        base_from_tool: &Pose<Base, Tool>,
        tool_from_sensor: &Pose<Tool, Sensor>,
        twist: &Twist<Aligned<Tool, Base>>,
    ) -> Option<SensorMotion> {
        let lever = base_from_tool.rotate(&tool_from_sensor.translation());
        let (linear, angular) = (twist.linear + twist.angular.cross(&lever), twist.angular);
        let finite = time_s.is_finite() && (linear + angular).iter().all(|x| x.is_finite());
        let last = std::mem::replace(&mut self.last, finite.then_some((time_s, linear, angular)));
        let (before_s, linear_before, angular_before) = last.filter(|_| finite)?;
        let span = time_s - before_s;
        if !(span > 0.0 && span <= SPAN_MAX_S) {
            return None;
        }
        let sensor = *base_from_tool * *tool_from_sensor;
        Some(SensorMotion {
            acceleration: sensor.unrotate(&((linear - linear_before) / span)),
            angular_velocity: sensor.unrotate(&angular),
            angular_acceleration: sensor.unrotate(&((angular - angular_before) / span)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Payload;
    use nalgebra::UnitQuaternion;
    use tangent_mechanics::Wrench;

    /// A payload swung about a point beside it: the force on the sensor is that of its centre of
    /// mass, whatever frame the twist was given in.
    #[test]
    fn the_wrench_of_a_swinging_payload_is_that_of_its_acceleration() {
        let payload = Payload {
            mass_kg: 0.8,
            com_in_sensor_m: [0.01, -0.02, 0.1],
            inertia_kg_m2: [4e-3, 5e-3, 5e-4],
        };
        let tool_from_sensor: Pose<Tool, Sensor> = Pose::new(
            Vector3::new(0.01, 0.02, -0.25),
            UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.1, 0.4)),
        );
        let spin = |t: f64| Vector3::new(0.3 * (4.0 * t).sin(), 0.5 * t, -0.2);
        let (dt, mut rotation) = (1e-4, UnitQuaternion::identity());
        let mut state = SensorMotionState::default();
        let (mut at, mut com_speeds, mut wrench) = (Vector3::zeros(), Vec::new(), None);
        let mut sensor_rotation = UnitQuaternion::identity();
        for i in 0..200 {
            let t = f64::from(i) * dt;
            let linear = Vector3::new(t, 0.3 * (3.0 * t).cos(), -0.1);
            let tool: Pose<Base, Tool> = Pose::new(at, rotation);
            let twist = Twist::new(linear, spin(t));
            let com = tool_from_sensor.transform_point(&Vector3::from(payload.com_in_sensor_m));
            com_speeds.push(linear + spin(t).cross(&tool.rotate(&com)));
            let motion = state.update(t, &tool, &tool_from_sensor, &twist);
            wrench = motion.map(|m| payload.wrench(&Vector3::zeros(), Some(&m)));
            sensor_rotation = (tool * tool_from_sensor).rotation();
            at += linear * dt;
            rotation = UnitQuaternion::from_scaled_axis(spin(t) * dt) * rotation;
        }
        let wrench: Wrench<Sensor> = wrench.unwrap();
        let n = com_speeds.len();
        let acceleration = (com_speeds[n - 1] - com_speeds[n - 2]) / dt;
        let force = sensor_rotation * wrench.force;
        let error = (force + acceleration * payload.mass_kg).norm();
        assert!(error < 2e-3, "{error} of {} N", force.norm());
        assert!(force.norm() > 0.5);
    }

    #[test]
    fn gaps_repeats_and_nonsense_give_no_motion() {
        let (tool, sensor) = (Pose::identity(), Pose::identity());
        let twist = Twist::new(Vector3::x(), Vector3::zeros());
        let bad = Twist::new(Vector3::repeat(f64::NAN), Vector3::zeros());
        let mut state = SensorMotionState::default();
        for (time_s, twist, known) in [
            (0.0, &twist, false),
            (0.001, &twist, true),
            (0.001, &twist, false),
            (0.1, &twist, false),
            (0.101, &bad, false),
            (0.102, &twist, false),
            (0.103, &twist, true),
        ] {
            let motion = state.update(time_s, &tool, &sensor, twist);
            assert_eq!(motion.is_some(), known, "{time_s}");
        }
    }
}
