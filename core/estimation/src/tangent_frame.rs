//! A unit normal with two tangent axes that move with it without spinning about it.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Two tangent axes and a normal, orthonormal, in base axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TangentFrame {
    pub first: Vector3<f64>,
    pub second: Vector3<f64>,
    pub normal: Vector3<f64>,
}

impl TangentFrame {
    /// Frame around a unit normal; its first axis is as close to `hint` as possible.
    pub fn new(normal: Vector3<f64>, hint: Vector3<f64>) -> Self {
        let mut first = hint - normal * normal.dot(&hint);
        if first.norm() < 1e-6 {
            // The hint is parallel to the normal: any axis away from the normal will do.
            let away = normal.iamin();
            first = Vector3::ith(away, 1.0);
            first -= normal * normal.dot(&first);
        }
        let first = first.normalize();
        Self {
            first,
            second: normal.cross(&first),
            normal,
        }
    }

    /// Tangential components of a vector.
    pub fn project(&self, vector: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(self.first.dot(vector), self.second.dot(vector))
    }

    /// Vector with these tangential components.
    pub fn lift(&self, tangent: &Vector2<f64>) -> Vector3<f64> {
        self.first * tangent.x + self.second * tangent.y
    }

    /// Tangential 2×2 matrix converted to base axes, zero along the normal.
    pub fn lift_matrix(&self, m: &Matrix2<f64>) -> Matrix3<f64> {
        let (a, b) = (&self.first, &self.second);
        let mut lifted = (a * a.transpose()) * m.m11
            + (b * b.transpose()) * m.m22
            + (a * b.transpose() + b * a.transpose()) * (0.5 * (m.m12 + m.m21));
        // Exactly symmetric, so that readers can compare entries.
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let mean = 0.5 * (lifted[(i, j)] + lifted[(j, i)]);
            lifted[(i, j)] = mean;
            lifted[(j, i)] = mean;
        }
        lifted
    }

    /// Tangential part of a matrix in base axes.
    pub fn project_matrix(&self, m: &Matrix3<f64>) -> Matrix2<f64> {
        let (a, b) = (&self.first, &self.second);
        let cross = 0.5 * (a.dot(&(m * b)) + b.dot(&(m * a)));
        Matrix2::new(a.dot(&(m * a)), cross, cross, b.dot(&(m * b)))
    }

    /// The matrix without its parts along the normal.
    pub fn flatten(&self, m: &Matrix3<f64>) -> Matrix3<f64> {
        self.lift_matrix(&self.project_matrix(m))
    }

    /// Rotates the normal by tangential components (rad) along a great circle; the axes follow
    /// without spin.
    pub fn turned(&self, tangent: &Vector2<f64>) -> Self {
        let angle = tangent.norm();
        if angle < 1e-15 {
            return *self;
        }
        let direction = self.lift(tangent) / angle;
        let (sin, cos) = angle.sin_cos();
        let turn = |v: &Vector3<f64>| {
            let along = direction.dot(v);
            let out = self.normal.dot(v);
            v + direction * (along * (cos - 1.0) + out * sin)
                + self.normal * (out * (cos - 1.0) - along * sin)
        };
        // Gram-Schmidt keeps rounding errors from accumulating over hours.
        let normal = turn(&self.normal).normalize();
        Self::new(normal, turn(&self.first))
    }

    /// Tangential components (rad) of the great circle from the normal to another unit vector.
    pub fn logarithm(&self, unit: &Vector3<f64>) -> Vector2<f64> {
        let tangent = self.project(unit);
        let sin = tangent.norm();
        if sin < 1e-15 {
            return tangent;
        }
        tangent * (sin.atan2(self.normal.dot(unit)) / sin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn turning_and_its_logarithm_are_inverse(n in prop::array::uniform3(-1.0f64..1.0),
                                                 t in prop::array::uniform2(-1.0f64..1.0)) {
            prop_assume!(Vector3::from(n).norm() > 0.1);
            let frame = TangentFrame::new(Vector3::from(n).normalize(), Vector3::x());
            let turned = frame.turned(&Vector2::from(t));
            prop_assert!((frame.logarithm(&turned.normal) - Vector2::from(t)).norm() < 1e-9);
            prop_assert!(turned.first.dot(&turned.normal).abs() < 1e-12);
            prop_assert!((turned.first.cross(&turned.second) - turned.normal).norm() < 1e-12);
        }

        #[test]
        fn a_matrix_lifted_and_projected_is_itself(n in prop::array::uniform3(-1.0f64..1.0),
                                                   m in prop::array::uniform3(-5.0f64..5.0)) {
            prop_assume!(Vector3::from(n).norm() > 0.1);
            let frame = TangentFrame::new(Vector3::from(n).normalize(), Vector3::y());
            let matrix = Matrix2::new(m[0], m[1], m[1], m[2]);
            let lifted = frame.lift_matrix(&matrix);
            prop_assert!((frame.project_matrix(&lifted) - matrix).norm() < 1e-12);
            prop_assert!((lifted * frame.normal).norm() < 1e-12);
        }
    }
}
