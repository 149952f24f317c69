//! The frames of a cell, as types without values.

use std::marker::PhantomData;

/// A coordinate frame: an origin and three axes.
///
/// ```
/// use tangent_mechanics::{Aligned, Base, Frame, Tool};
/// assert_eq!(Base::NAME, "base");
/// // A vector in base axes is published in the frame `base`, wherever its origin is.
/// assert_eq!(Aligned::<Tool, Base>::NAME, "base");
/// ```
pub trait Frame: Copy + 'static {
    /// Name of the frame in messages (`frame_id`).
    const NAME: &'static str;
}

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident = $text:literal;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct $name;
        impl Frame for $name {
            const NAME: &'static str = $text;
        }
    )*};
}

frames! {
    /// Fixed to the floor.
    World = "world";
    /// The arm's base, as its manufacturer defines it.
    Base = "base";
    /// The arm's tool flange.
    Flange = "flange";
    /// The force/torque sensor's own frame.
    Sensor = "sensor";
    /// Origin at the tool's contact point, z out of the tool and into the surface.
    Tool = "tool";
    /// Optical centre of a camera, z forward.
    Camera = "camera";
    /// Fixed to an object of known shape and unknown pose.
    Object = "object";
    /// Origin at the contact point, z along the surface normal, out of the material.
    Contact = "contact";
}

/// The frame with the origin of `O` and axes parallel to those of `A`.
///
/// A geometric Jacobian gives a twist in `Aligned<Flange, Base>`: of the flange's origin, in base
/// axes.
///
/// ```
/// use tangent_mechanics::{Aligned, Arm, Base, Flange, Joints, ModelData, Twist};
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// let qd = Joints::<6>::repeat(0.1);
/// let twist = Twist::<Aligned<Flange, Base>>::from_vector(&(arm.jacobian(&arm.home()) * qd));
/// assert!(twist.is_finite());
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Debug, PartialEq, Eq)]
pub struct Aligned<O, A>(PhantomData<(O, A)>);

impl<O, A> Clone for Aligned<O, A> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<O, A> Copy for Aligned<O, A> {}

impl<O: Frame, A: Frame> Frame for Aligned<O, A> {
    const NAME: &'static str = A::NAME;
}
