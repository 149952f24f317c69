//! Rigid-body velocity in a named frame.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Add, Mul, Neg, Sub};

use nalgebra::{Vector3, Vector6};

/// Velocity of a rigid body: `linear` of the origin of `F` (m/s), then `angular` (rad/s), in the
/// axes of `F`.
pub struct Twist<F> {
    /// m/s, in the axes of `F`.
    pub linear: Vector3<f64>,
    /// rad/s, in the axes of `F`.
    pub angular: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Twist<F> {
    /// Both parts in the axes of `F`.
    pub fn new(linear: Vector3<f64>, angular: Vector3<f64>) -> Self {
        Self {
            linear,
            angular,
            frame: PhantomData,
        }
    }

    /// All zero.
    pub fn zero() -> Self {
        Self::new(Vector3::zeros(), Vector3::zeros())
    }

    /// Linear part first, then angular.
    pub fn from_vector(vector: &Vector6<f64>) -> Self {
        Self::new(
            vector.fixed_rows::<3>(0).into_owned(),
            vector.fixed_rows::<3>(3).into_owned(),
        )
    }

    /// Linear part first, then angular.
    pub fn vector(&self) -> Vector6<f64> {
        let (a, b) = (&self.linear, &self.angular);
        Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
    }

    /// No entry is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.vector().iter().all(|x| x.is_finite())
    }
}

impl<F> Add for Twist<F> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::new(self.linear + other.linear, self.angular + other.angular)
    }
}

impl<F> Sub for Twist<F> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::new(self.linear - other.linear, self.angular - other.angular)
    }
}

impl<F> Mul<f64> for Twist<F> {
    type Output = Self;

    fn mul(self, scale: f64) -> Self {
        Self::new(self.linear * scale, self.angular * scale)
    }
}

impl<F> Neg for Twist<F> {
    type Output = Self;

    fn neg(self) -> Self {
        self * -1.0
    }
}

impl<F> Clone for Twist<F> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<F> Copy for Twist<F> {}

impl<F> PartialEq for Twist<F> {
    fn eq(&self, other: &Self) -> bool {
        self.linear == other.linear && self.angular == other.angular
    }
}

impl<F> fmt::Debug for Twist<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Twist")
            .field("linear", &self.linear)
            .field("angular", &self.angular)
            .finish()
    }
}
