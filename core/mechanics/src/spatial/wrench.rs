//! Force and torque in a named frame.

use std::marker::PhantomData;

use nalgebra::{Vector3, Vector6};

use super::{Twist, linear_space, plain_data};

/// Force (N) and torque (Nm) that the environment exerts on the robot, at the origin and in the
/// axes of `F`.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Pose, Sensor, Tool, Wrench};
///
/// // A sideways force at the tool's tip bends the sensor behind it.
/// let sensor_from_tool: Pose<Sensor, Tool> =
///     Pose::new(Vector3::new(0.0, 0.0, 0.2), UnitQuaternion::identity());
/// let at_tip = Wrench::<Tool>::new(Vector3::new(10.0, 0.0, 0.0), Vector3::zeros());
/// let at_sensor: Wrench<Sensor> = sensor_from_tool.transform_wrench(&at_tip);
/// assert_eq!(at_sensor.torque, Vector3::new(0.0, 2.0, 0.0));
/// ```
pub struct Wrench<F> {
    /// Force in the axes of `F`, N.
    pub force: Vector3<f64>,
    /// Torque about the origin of `F`, in the axes of `F`, Nm.
    pub torque: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Wrench<F> {
    /// Wrench from force (N) and torque (Nm), both in the axes of `F`.
    pub fn new(force: Vector3<f64>, torque: Vector3<f64>) -> Self {
        Self {
            force,
            torque,
            frame: PhantomData,
        }
    }

    /// No load.
    pub fn zero() -> Self {
        Self::new(Vector3::zeros(), Vector3::zeros())
    }

    /// Wrench from a vector of the force (N), then the torque (Nm).
    pub fn from_vector(vector: &Vector6<f64>) -> Self {
        Self::new(
            vector.fixed_rows::<3>(0).into_owned(),
            vector.fixed_rows::<3>(3).into_owned(),
        )
    }

    /// Vector of the force (N), then the torque (Nm).
    pub fn vector(&self) -> Vector6<f64> {
        let (a, b) = (&self.force, &self.torque);
        Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
    }

    /// No entry is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.vector().iter().all(|x| x.is_finite())
    }

    /// Power that this wrench puts into a body moving with `twist`, W.
    pub fn power(&self, twist: &Twist<F>) -> f64 {
        self.force.dot(&twist.linear) + self.torque.dot(&twist.angular)
    }
}

plain_data!(Wrench { force, torque });
linear_space!(Wrench { force, torque });
