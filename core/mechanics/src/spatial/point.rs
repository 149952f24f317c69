//! Position of a point in a named frame.

use std::marker::PhantomData;
use std::ops::{Add, Sub};

use nalgebra::Vector3;

use super::{Direction, plain_data};

/// Position of a point: its coordinates in the frame `F`, m.
///
/// A [`Pose<A, F>`](crate::Pose) takes it to frame `A` with rotation and translation. Two points of
/// one frame differ by a [`Direction`].
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Base, Point, Pose, Tool};
///
/// let base_from_tool: Pose<Base, Tool> =
///     Pose::new(Vector3::new(0.4, 0.0, 0.3), UnitQuaternion::identity());
/// let tip: Point<Tool> = Point::new(Vector3::new(0.0, 0.0, 0.1));
/// let tip_in_base: Point<Base> = base_from_tool * tip;
/// assert_eq!(tip_in_base.coordinates(), Vector3::new(0.4, 0.0, 0.4));
/// ```
///
/// A point in the wrong frame does not compile:
///
/// ```compile_fail
/// use tangent_mechanics::{Base, Flange, Point, Pose, Tool};
/// let base_from_tool: Pose<Base, Tool> = Pose::identity();
/// let on_flange: Point<Flange> = Point::origin();
/// let wrong = base_from_tool * on_flange;
/// ```
pub struct Point<F> {
    coordinates: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Point<F> {
    /// Point with the given coordinates in `F`, m.
    pub fn new(coordinates: Vector3<f64>) -> Self {
        Self {
            coordinates,
            frame: PhantomData,
        }
    }

    /// Origin of `F`.
    pub fn origin() -> Self {
        Self::new(Vector3::zeros())
    }

    /// Coordinates in `F`, m.
    pub fn coordinates(&self) -> Vector3<f64> {
        self.coordinates
    }

    /// Distance to another point, m.
    pub fn distance(&self, other: &Self) -> f64 {
        (self.coordinates - other.coordinates).norm()
    }

    /// No coordinate is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.coordinates.iter().all(|x| x.is_finite())
    }
}

impl<F> Sub for Point<F> {
    type Output = Direction<F>;

    fn sub(self, other: Self) -> Direction<F> {
        Direction::new(self.coordinates - other.coordinates)
    }
}

impl<F> Add<Direction<F>> for Point<F> {
    type Output = Self;

    fn add(self, displacement: Direction<F>) -> Self {
        Self::new(self.coordinates + displacement.components())
    }
}

plain_data!(Point { coordinates });
