//! Force and torque in a named frame.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Add, Mul, Neg, Sub};

use nalgebra::{Vector3, Vector6};

/// What the environment does to the robot, at the origin and in the axes of `F`: `force` (N), then
/// `torque` (Nm).
pub struct Wrench<F> {
    /// N, in the axes of `F`.
    pub force: Vector3<f64>,
    /// Nm, in the axes of `F`.
    pub torque: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Wrench<F> {
    /// Both parts in the axes of `F`.
    pub fn new(force: Vector3<f64>, torque: Vector3<f64>) -> Self {
        Self {
            force,
            torque,
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
        let (a, b) = (&self.force, &self.torque);
        Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
    }

    /// No entry is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.vector().iter().all(|x| x.is_finite())
    }
}

impl<F> Wrench<F> {
    /// Power that this wrench puts into a body moving with `twist`, W.
    pub fn power(&self, twist: &super::Twist<F>) -> f64 {
        self.force.dot(&twist.linear) + self.torque.dot(&twist.angular)
    }
}

impl<F> Add for Wrench<F> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::new(self.force + other.force, self.torque + other.torque)
    }
}

impl<F> Sub for Wrench<F> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::new(self.force - other.force, self.torque - other.torque)
    }
}

impl<F> Mul<f64> for Wrench<F> {
    type Output = Self;

    fn mul(self, scale: f64) -> Self {
        Self::new(self.force * scale, self.torque * scale)
    }
}

impl<F> Neg for Wrench<F> {
    type Output = Self;

    fn neg(self) -> Self {
        self * -1.0
    }
}

impl<F> Clone for Wrench<F> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<F> Copy for Wrench<F> {}

impl<F> PartialEq for Wrench<F> {
    fn eq(&self, other: &Self) -> bool {
        self.force == other.force && self.torque == other.torque
    }
}

impl<F> fmt::Debug for Wrench<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Wrench")
            .field("force", &self.force)
            .field("torque", &self.torque)
            .finish()
    }
}
