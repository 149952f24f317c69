//! The frames of a cell, as types without values.

use std::marker::PhantomData;

/// A coordinate frame: an origin and three axes.
pub trait Frame: Copy + 'static {
    /// The frame's name as it stands in messages (`frame_id`).
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
    /// The arm's base, as its maker defines it.
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
/// A geometric Jacobian speaks in `Aligned<Flange, Base>`: velocity of the flange's origin, in base
/// axes.
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
