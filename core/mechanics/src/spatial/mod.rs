//! Spatial algebra with frames as types.
//!
//! A [`Pose<A, B>`](Pose) composes only with a `Pose<B, C>`, and takes a [`Point`], [`Direction`],
//! [`Twist`] or [`Wrench`] in `B` to one in `A`. A mixed-up frame therefore does not compile.

mod direction;
mod frame;
mod point;
mod pose;
mod twist;
mod wrench;

pub use direction::Direction;
pub use frame::{Aligned, Base, Camera, Contact, Flange, Frame, Object, Sensor, Tool, World};
pub use point::Point;
pub use pose::Pose;
pub use twist::Twist;
pub use wrench::Wrench;

/// Implements `Clone`, `Copy`, `PartialEq` and `Debug` for coordinates in a frame `F`.
///
/// Derived impls would needlessly require the same traits of the frame marker.
macro_rules! plain_data {
    ($name:ident { $($field:ident),+ }) => {
        impl<F> Clone for $name<F> {
            fn clone(&self) -> Self {
                *self
            }
        }

        impl<F> Copy for $name<F> {}

        impl<F> PartialEq for $name<F> {
            fn eq(&self, other: &Self) -> bool {
                $(self.$field == other.$field)&&+
            }
        }

        impl<F> std::fmt::Debug for $name<F> {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.debug_struct(stringify!($name))
                    $(.field(stringify!($field), &self.$field))+
                    .finish()
            }
        }
    };
}

/// Implements `+`, `-`, negation and scaling, field by field, for quantities in the same frame.
macro_rules! linear_space {
    ($name:ident { $($field:ident),+ }) => {
        impl<F> std::ops::Add for $name<F> {
            type Output = Self;

            fn add(self, other: Self) -> Self {
                Self::new($(self.$field + other.$field),+)
            }
        }

        impl<F> std::ops::Sub for $name<F> {
            type Output = Self;

            fn sub(self, other: Self) -> Self {
                Self::new($(self.$field - other.$field),+)
            }
        }

        impl<F> std::ops::Mul<f64> for $name<F> {
            type Output = Self;

            fn mul(self, scale: f64) -> Self {
                Self::new($(self.$field * scale),+)
            }
        }

        impl<F> std::ops::Neg for $name<F> {
            type Output = Self;

            fn neg(self) -> Self {
                self * -1.0
            }
        }
    };
}

use {linear_space, plain_data};
