//! Free vector in the axes of a named frame.

use std::marker::PhantomData;

use nalgebra::Vector3;

use super::{linear_space, plain_data};

/// Free vector: its components in the axes of the frame `F`.
///
/// A surface normal, a displacement (m) or the velocity of a point (m/s). A
/// [`Pose<A, F>`](crate::Pose) takes it to the axes of `A` with its rotation alone, which
/// distinguishes it from a [`Point`](crate::Point).
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Base, Direction, Pose, Tool};
///
/// // A tool that points down.
/// let base_from_tool: Pose<Base, Tool> = Pose::new(
///     Vector3::new(0.4, 0.0, 0.3),
///     UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
/// );
/// let normal: Direction<Base> = -(base_from_tool * Direction::<Tool>::z());
/// assert!((normal.components() - Vector3::z()).norm() < 1e-15);
/// ```
pub struct Direction<F> {
    components: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Direction<F> {
    /// Vector with the given components in the axes of `F`.
    pub fn new(components: Vector3<f64>) -> Self {
        Self {
            components,
            frame: PhantomData,
        }
    }

    /// Unit vector along the z axis of `F`.
    pub fn z() -> Self {
        Self::new(Vector3::z())
    }

    /// Components in the axes of `F`.
    pub fn components(&self) -> Vector3<f64> {
        self.components
    }

    /// Length, in the unit of the components.
    pub fn length(&self) -> f64 {
        self.components.norm()
    }

    /// Vector of length one in the same direction; `None` if this one is not longer than
    /// `length_min`.
    pub fn unit(&self, length_min: f64) -> Option<Self> {
        self.components.try_normalize(length_min).map(Self::new)
    }

    /// Scalar product.
    pub fn dot(&self, other: &Self) -> f64 {
        self.components.dot(&other.components)
    }

    /// Vector product.
    pub fn cross(&self, other: &Self) -> Self {
        Self::new(self.components.cross(&other.components))
    }

    /// No component is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.components.iter().all(|x| x.is_finite())
    }
}

plain_data!(Direction { components });
linear_space!(Direction { components });
