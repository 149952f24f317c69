//! Rigid-body velocity in a named frame.

use std::marker::PhantomData;

use nalgebra::{Vector3, Vector6};

use super::{linear_space, plain_data};

/// Velocity of a rigid body in the axes of `F`: of the origin of `F` (m/s), and angular (rad/s).
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Flange, Pose, Tool, Twist};
///
/// // A flange that rotates about its z axis moves a tool that lies beside that axis.
/// let tool_from_flange: Pose<Tool, Flange> =
///     Pose::new(Vector3::new(-0.1, 0.0, 0.0), UnitQuaternion::identity());
/// let flange = Twist::<Flange>::new(Vector3::zeros(), Vector3::z());
/// let tool: Twist<Tool> = tool_from_flange.transform_twist(&flange);
/// assert_eq!(tool.linear, Vector3::new(0.0, 0.1, 0.0));
/// ```
pub struct Twist<F> {
    /// Velocity of the origin of `F`, in the axes of `F`, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity, in the axes of `F`, rad/s.
    pub angular: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Twist<F> {
    /// Twist from linear (m/s) and angular velocity (rad/s), both in the axes of `F`.
    pub fn new(linear: Vector3<f64>, angular: Vector3<f64>) -> Self {
        Self {
            linear,
            angular,
            frame: PhantomData,
        }
    }

    /// Twist of a body at rest.
    pub fn zero() -> Self {
        Self::new(Vector3::zeros(), Vector3::zeros())
    }

    /// Twist from a vector of the linear part (m/s), then the angular part (rad/s).
    pub fn from_vector(vector: &Vector6<f64>) -> Self {
        Self::new(
            vector.fixed_rows::<3>(0).into_owned(),
            vector.fixed_rows::<3>(3).into_owned(),
        )
    }

    /// Vector of the linear part (m/s), then the angular part (rad/s).
    pub fn vector(&self) -> Vector6<f64> {
        let (a, b) = (&self.linear, &self.angular);
        Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
    }

    /// No entry is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.vector().iter().all(|x| x.is_finite())
    }
}

plain_data!(Twist { linear, angular });
linear_space!(Twist { linear, angular });
