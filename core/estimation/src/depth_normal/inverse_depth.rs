//! Point, normal and curvature of the surface from a fit of inverse depth, in camera axes.
//!
//! With `a = x/z` and `b = y/z` the surface is `G(x, y, z) = z w(x/z, y/z) - 1 = 0`, where
//! `w = 1/z`: a plane in space is a plane in `w`, which is why the fits are made there. `G` is
//! homogeneous of degree one, so gradient and second derivatives are short.

use nalgebra::{Matrix3, Vector3};

/// Inverse depth and its derivatives at a ray `[a, b]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InverseDepth {
    /// `x/z`, `y/z`.
    pub ray: [f64; 2],
    /// Inverse depth, 1/m.
    pub w: f64,
    /// Derivatives with respect to `a` and `b`, 1/m.
    pub slope: [f64; 2],
    /// Second derivatives `aa`, `ab`, `bb`, 1/m.
    pub bend: [f64; 3],
}

impl InverseDepth {
    /// Point on the surface, m; `None` if inverse depth is not positive.
    pub fn point(&self) -> Option<Vector3<f64>> {
        let [a, b] = self.ray;
        (self.w > 0.0).then(|| Vector3::new(a, b, 1.0) / self.w)
    }

    /// ∇G, into the material, 1/m.
    pub fn gradient(&self) -> Vector3<f64> {
        let ([a, b], [wa, wb]) = (self.ray, self.slope);
        Vector3::new(wa, wb, self.w - a * wa - b * wb)
    }

    /// Unit normal, out of the material, towards the camera; `None` if the gradient is zero.
    pub fn normal(&self) -> Option<Vector3<f64>> {
        let gradient = self.gradient();
        let length = gradient.norm();
        (length > 1e-12).then(|| gradient / -length)
    }

    /// Covariance of the normal, rad², from that of `[w, w_a, w_b]`; singular along the normal.
    pub fn normal_covariance(&self, of_w_and_slope: &Matrix3<f64>) -> Matrix3<f64> {
        let jacobian = self.normal_jacobian();
        jacobian * of_w_and_slope * jacobian.transpose()
    }

    /// Derivative of the normal with respect to `[w, w_a, w_b]`.
    pub fn normal_jacobian(&self) -> Matrix3<f64> {
        let [a, b] = self.ray;
        let gradient = self.gradient();
        let length = gradient.norm().max(1e-12);
        let n = gradient / length;
        let of_gradient = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, -a, -b);
        (n * n.transpose() - Matrix3::identity()) * of_gradient / length
    }

    /// Shape operator, 1/m: moving by `dp` turns the normal by `curvature dp`; positive for a
    /// convex body. `None` if there is no point.
    pub fn curvature(&self) -> Option<Matrix3<f64>> {
        let normal = self.normal()?;
        if self.w <= 0.0 {
            return None;
        }
        let [a, b] = self.ray;
        // The second derivatives of G are z⁻¹ Aᵀ B A with A = [1 0 -a; 0 1 -b].
        let [aa, ab, bb] = self.bend;
        let (xz, yz) = (-(a * aa + b * ab), -(a * ab + b * bb));
        let zz = a * a * aa + 2.0 * a * b * ab + b * b * bb;
        let second = Matrix3::new(aa, ab, xz, ab, bb, yz, xz, yz, zz) * self.w;
        let project = Matrix3::identity() - normal * normal.transpose();
        Some(project * second * project * (-1.0 / self.gradient().norm()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Inverse depth of a sphere in closed form, with derivatives by finite differences.
    fn sphere(ray: [f64; 2], centre: Vector3<f64>, radius: f64) -> InverseDepth {
        let w = |a: f64, b: f64| {
            let direction = Vector3::new(a, b, 1.0);
            let (dot, square) = (direction.dot(&centre), direction.norm_squared());
            let rest = centre.norm_squared() - radius * radius;
            square / (dot - (dot * dot - square * rest).sqrt())
        };
        let [a, b] = ray;
        let h = 1e-4;
        let bend_ab =
            (w(a + h, b + h) - w(a + h, b - h) - w(a - h, b + h) + w(a - h, b - h)) / (4.0 * h * h);
        InverseDepth {
            ray,
            w: w(a, b),
            slope: [
                (w(a + h, b) - w(a - h, b)) / (2.0 * h),
                (w(a, b + h) - w(a, b - h)) / (2.0 * h),
            ],
            bend: [
                (w(a + h, b) - 2.0 * w(a, b) + w(a - h, b)) / (h * h),
                bend_ab,
                (w(a, b + h) - 2.0 * w(a, b) + w(a, b - h)) / (h * h),
            ],
        }
    }

    #[test]
    fn a_sphere_has_its_normal_and_curvature() {
        let centre = Vector3::new(0.05, -0.02, 0.6);
        for ray in [[0.0, 0.0], [0.1, -0.1], [0.2, 0.1], [0.3, -0.05]] {
            let at = sphere(ray, centre, 0.2);
            let normal = (at.point().unwrap() - centre).normalize();
            assert!((at.normal().unwrap() - normal).norm() < 1e-5);
            let expected = (Matrix3::identity() - normal * normal.transpose()) / 0.2;
            assert!((at.curvature().unwrap() - expected).norm() < 1e-3);
        }
    }

    #[test]
    fn the_jacobian_of_the_normal_is_that_of_finite_differences() {
        let at = sphere([0.2, -0.1], Vector3::new(0.0, 0.0, 0.5), 0.15);
        let jacobian = at.normal_jacobian();
        let h = 1e-6;
        for i in 0..3 {
            let moved = |h: f64| {
                let mut m = at;
                match i {
                    0 => m.w += h,
                    _ => m.slope[i - 1] += h,
                }
                m.normal().unwrap()
            };
            let difference = (moved(h) - moved(-h)) / (2.0 * h);
            assert!((difference - jacobian.column(i)).norm() < 1e-8);
        }
    }

    #[test]
    fn nothing_is_said_of_what_is_behind_the_camera() {
        let none = InverseDepth::default();
        assert!(none.point().is_none() && none.normal().is_none() && none.curvature().is_none());
        let behind = InverseDepth {
            w: -1.0,
            slope: [0.5, 0.0],
            ..none
        };
        assert!(behind.point().is_none() && behind.curvature().is_none());
    }
}
