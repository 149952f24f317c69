//! A normal with its covariance, and the fusion of two of them in the plane between them.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector3};

/// Lower bound of a normal's variance, rad².
pub const VARIANCE_LEAST: f64 = 1e-8;

/// A normal with its covariance.
#[derive(Clone, Copy, Debug)]
pub struct Belief {
    /// Unit, base axes.
    pub normal: Vector3<f64>,
    /// Covariance, rad², base axes; zero along the normal.
    pub covariance: Matrix3<f64>,
}

impl Belief {
    /// Normal with the same variance (rad²) in every direction.
    pub fn round(normal: Vector3<f64>, variance: f64) -> Self {
        Self {
            normal,
            covariance: across(&normal) * variance,
        }
    }

    /// Mean variance of one direction, rad².
    pub fn variance(&self) -> f64 {
        0.5 * self.covariance.trace().max(0.0)
    }

    /// This belief with `variance` (rad²) added to its covariance in every direction; the normal is
    /// unchanged.
    pub fn doubted(&self, variance: f64) -> Self {
        Self {
            normal: self.normal,
            covariance: self.covariance + across(&self.normal) * variance,
        }
    }

    /// Normal and covariance rotated together.
    pub fn turned(&self, by: &Vector3<f64>) -> Self {
        let n = &self.normal;
        let normal = (n + by - n * n.dot(by)).normalize();
        let plane = across(&normal);
        Self {
            normal,
            covariance: plane * self.covariance * plane,
        }
    }

    /// Fusion of both normals, by their covariances in the plane between them.
    pub fn with(&self, other: &Self) -> Self {
        let surer = if self.variance() <= other.variance() {
            self
        } else {
            other
        };
        let sum = self.normal + other.normal;
        // Opposite normals belong to no common surface.
        if sum.norm() < 0.2 {
            return *surer;
        }
        let plane = tangents(&sum.normalize());
        let (a, b) = (
            planar(&self.covariance, &plane),
            planar(&other.covariance, &plane),
        );
        let Some(inverse) = (a + b).try_inverse() else {
            return *surer;
        };
        let gain = a * inverse;
        let away = plane.tr_mul(&(other.normal - self.normal));
        let normal = (self.normal + plane * (gain * away)).normalize();
        let left = (Matrix2::identity() - gain) * a;
        let left = plane * ((left + left.transpose()) * 0.5) * plane.transpose();
        let flat = across(&normal);
        Self {
            normal,
            covariance: flat * left * flat,
        }
    }
}

/// Projection onto the plane perpendicular to `normal`.
fn across(normal: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - normal * normal.transpose()
}

/// Two orthogonal directions in that plane.
pub fn tangents(normal: &Vector3<f64>) -> Matrix3x2<f64> {
    let least = normal.iamin();
    let u = normal.cross(&Vector3::ith(least, 1.0)).normalize();
    Matrix3x2::from_columns(&[u, normal.cross(&u)])
}

/// A covariance reduced to a plane. If the result is not a valid covariance, an isotropic one
/// replaces it.
fn planar(covariance: &Matrix3<f64>, plane: &Matrix3x2<f64>) -> Matrix2<f64> {
    let m = plane.transpose() * covariance * plane;
    let m = (m + m.transpose()) * 0.5 + Matrix2::identity() * VARIANCE_LEAST;
    if m.m11 > 0.0 && m.determinant() > 0.0 {
        m
    } else {
        Matrix2::identity() * (0.5 * covariance.trace()).max(VARIANCE_LEAST)
    }
}
