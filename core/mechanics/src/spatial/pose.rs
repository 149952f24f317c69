//! Rigid transforms between named frames.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra::{Isometry3, Matrix4, Translation3, UnitQuaternion, Vector3};

use super::{Aligned, Direction, Frame, Point, Twist, Wrench};

/// `Pose<A, B>` is `a_from_b`: it takes coordinates in `B` to coordinates in `A` (metres).
///
/// Multiplied by a [`Point`] it rotates and translates; multiplied by a [`Direction`] it only
/// rotates.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Base, Flange, Point, Pose, Tool};
///
/// let base_from_flange: Pose<Base, Flange> =
///     Pose::new(Vector3::new(0.5, 0.0, 0.3), UnitQuaternion::identity());
/// let flange_from_tool: Pose<Flange, Tool> =
///     Pose::new(Vector3::new(0.0, 0.0, 0.1), UnitQuaternion::identity());
/// let base_from_tool: Pose<Base, Tool> = base_from_flange * flange_from_tool;
/// assert_eq!(base_from_tool.origin(), Point::new(Vector3::new(0.5, 0.0, 0.4)));
/// ```
pub struct Pose<A, B> {
    isometry: Isometry3<f64>,
    frames: PhantomData<(A, B)>,
}

impl<A, B> Pose<A, B> {
    /// Origin of `B` in `A` (m), and the rotation that takes `B`'s axes to `A`'s.
    pub fn new(translation: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Self {
        Self::from_isometry(Isometry3::from_parts(
            Translation3::from(translation),
            rotation,
        ))
    }

    /// Pose from a plain nalgebra isometry that takes coordinates in `B` to coordinates in `A` (m).
    pub fn from_isometry(isometry: Isometry3<f64>) -> Self {
        Self {
            isometry,
            frames: PhantomData,
        }
    }

    /// Both frames coincide.
    pub fn identity() -> Self {
        Self::from_isometry(Isometry3::identity())
    }

    /// Origin of `B` as a point in `A`.
    pub fn origin(&self) -> Point<A> {
        Point::new(self.translation())
    }

    /// Coordinates of the origin of `B` in `A`, m.
    pub fn translation(&self) -> Vector3<f64> {
        self.isometry.translation.vector
    }

    /// Rotation that takes `B`'s axes to `A`'s.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        self.isometry.rotation
    }

    /// The plain nalgebra isometry, without frames.
    pub fn isometry(&self) -> &Isometry3<f64> {
        &self.isometry
    }

    /// Homogeneous 4×4 matrix.
    pub fn matrix(&self) -> Matrix4<f64> {
        self.isometry.to_homogeneous()
    }

    /// `b_from_a`.
    pub fn inverse(&self) -> Pose<B, A> {
        Pose::from_isometry(self.isometry.inverse())
    }

    /// Coordinates of a point in `A`, from those in `B` (m).
    pub fn transform_point(&self, point_in_b: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.rotation * point_in_b + self.isometry.translation.vector
    }

    /// Components of a free vector in the axes of `A`, from those in the axes of `B`.
    pub fn rotate(&self, vector_in_b: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.rotation * vector_in_b
    }

    /// Components of a free vector in the axes of `B`, from those in the axes of `A`.
    pub fn unrotate(&self, vector_in_a: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.rotation.inverse_transform_vector(vector_in_a)
    }

    /// Unit z axis of `B` in `A`'s axes.
    pub fn z_axis(&self) -> Vector3<f64> {
        self.rotate(&Vector3::z())
    }
}

impl<A: Frame, B: Frame> Pose<A, B> {
    /// Moves a wrench to `A`'s origin and `A`'s axes: the torque gains `r × f`.
    pub fn transform_wrench(&self, wrench_in_b: &Wrench<B>) -> Wrench<A> {
        let force = self.rotate(&wrench_in_b.force);
        Wrench::new(
            force,
            self.rotate(&wrench_in_b.torque) + self.translation().cross(&force),
        )
    }

    /// Twist of `A`'s origin in `A`'s axes for the rigid motion that `twist_in_b` describes: the
    /// velocity gains `r × ω`.
    pub fn transform_twist(&self, twist_in_b: &Twist<B>) -> Twist<A> {
        let angular = self.rotate(&twist_in_b.angular);
        Twist::new(
            self.rotate(&twist_in_b.linear) + self.translation().cross(&angular),
            angular,
        )
    }

    /// Rotates only the axes: a wrench at `B`'s origin, in axes of `A`.
    pub fn align_wrench(&self, wrench_in_b: &Wrench<B>) -> Wrench<Aligned<B, A>> {
        Wrench::new(
            self.rotate(&wrench_in_b.force),
            self.rotate(&wrench_in_b.torque),
        )
    }

    /// Rotates only the axes: a twist of `B`'s origin, in axes of `A`.
    pub fn align_twist(&self, twist_in_b: &Twist<B>) -> Twist<Aligned<B, A>> {
        Twist::new(
            self.rotate(&twist_in_b.linear),
            self.rotate(&twist_in_b.angular),
        )
    }

    /// Inverse of [`Pose::align_wrench`].
    pub fn unalign_wrench(&self, wrench: &Wrench<Aligned<B, A>>) -> Wrench<B> {
        Wrench::new(self.unrotate(&wrench.force), self.unrotate(&wrench.torque))
    }

    /// Inverse of [`Pose::align_twist`].
    pub fn unalign_twist(&self, twist: &Twist<Aligned<B, A>>) -> Twist<B> {
        Twist::new(self.unrotate(&twist.linear), self.unrotate(&twist.angular))
    }
}

impl<A, B, C> Mul<Pose<B, C>> for Pose<A, B> {
    type Output = Pose<A, C>;

    fn mul(self, b_from_c: Pose<B, C>) -> Pose<A, C> {
        Pose::from_isometry(self.isometry * b_from_c.isometry)
    }
}

impl<A, B> Mul<Point<B>> for Pose<A, B> {
    type Output = Point<A>;

    fn mul(self, point: Point<B>) -> Point<A> {
        Point::new(self.transform_point(&point.coordinates()))
    }
}

impl<A, B> Mul<Direction<B>> for Pose<A, B> {
    type Output = Direction<A>;

    fn mul(self, direction: Direction<B>) -> Direction<A> {
        Direction::new(self.rotate(&direction.components()))
    }
}

// Derived impls would needlessly require the same traits of the frame markers.
impl<A, B> Clone for Pose<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A, B> Copy for Pose<A, B> {}

impl<A, B> PartialEq for Pose<A, B> {
    fn eq(&self, other: &Self) -> bool {
        self.isometry == other.isometry
    }
}

impl<A, B> fmt::Debug for Pose<A, B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pose")
            .field("translation", &self.isometry.translation.vector)
            .field("rotation", &self.isometry.rotation)
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Base, Flange, Tool};
    use proptest::prelude::*;

    prop_compose! {
        fn pose()(t in prop::array::uniform3(-2.0f64..2.0), r in prop::array::uniform3(-3.0f64..3.0))
            -> (Vector3<f64>, UnitQuaternion<f64>) {
            (Vector3::from(t), UnitQuaternion::new(Vector3::from(r)))
        }
    }

    proptest! {
        #[test]
        fn power_does_not_depend_on_the_frame(p in pose(), w in prop::array::uniform6(-5.0f64..5.0),
                                              v in prop::array::uniform6(-5.0f64..5.0)) {
            let base_from_tool: Pose<Base, Tool> = Pose::new(p.0, p.1);
            let wrench = Wrench::<Tool>::from_vector(&w.into());
            let twist = Twist::<Tool>::from_vector(&v.into());
            let power = wrench.power(&twist);
            let in_base = base_from_tool.transform_wrench(&wrench).power(&base_from_tool.transform_twist(&twist));
            prop_assert!((power - in_base).abs() < 1e-9 * (1.0 + power.abs()));
        }

        #[test]
        fn the_difference_of_mapped_points_is_the_mapped_difference(
            p in pose(),
            a in prop::array::uniform3(-2.0f64..2.0),
            b in prop::array::uniform3(-2.0f64..2.0),
        ) {
            let base_from_tool: Pose<Base, Tool> = Pose::new(p.0, p.1);
            let (a, b) = (Point::<Tool>::new(a.into()), Point::<Tool>::new(b.into()));
            let by_points = base_from_tool * a - base_from_tool * b;
            let by_direction = base_from_tool * (a - b);
            prop_assert!((by_points - by_direction).length() < 1e-12);
            prop_assert!((by_direction.length() - a.distance(&b)).abs() < 1e-12);
            let back = base_from_tool.inverse() * (base_from_tool * a);
            prop_assert!(back.distance(&a) < 1e-12);
            prop_assert_eq!(base_from_tool * Point::origin(), base_from_tool.origin());
            prop_assert!((b + (a - b)).distance(&a) < 1e-12);
        }

        #[test]
        fn a_rotation_keeps_scalar_and_vector_products(
            p in pose(),
            a in prop::array::uniform3(-2.0f64..2.0),
            b in prop::array::uniform3(-2.0f64..2.0),
        ) {
            let base_from_tool: Pose<Base, Tool> = Pose::new(p.0, p.1);
            let (a, b) = (Direction::<Tool>::new(a.into()), Direction::<Tool>::new(b.into()));
            let (in_base_a, in_base_b) = (base_from_tool * a, base_from_tool * b);
            prop_assert!((in_base_a.dot(&in_base_b) - a.dot(&b)).abs() < 1e-12);
            let cross = base_from_tool * a.cross(&b) - in_base_a.cross(&in_base_b);
            prop_assert!(cross.length() < 1e-12);
        }

        #[test]
        fn a_wrench_there_and_back_is_itself(p in pose(), w in prop::array::uniform6(-5.0f64..5.0)) {
            let flange_from_tool: Pose<Flange, Tool> = Pose::new(p.0, p.1);
            let wrench = Wrench::<Tool>::from_vector(&w.into());
            let back = flange_from_tool.inverse().transform_wrench(&flange_from_tool.transform_wrench(&wrench));
            prop_assert!((back.vector() - wrench.vector()).norm() < 1e-9);
        }
    }
}
