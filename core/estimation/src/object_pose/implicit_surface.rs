//! The object's surface as φ(p) = 0 in object axes, with gradient and Hessian: all that eqs. (1),
//! (2), (19)-(26) require of a shape.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// A twice differentiable surface φ(p) = 0, φ > 0 outside the material. Points in object axes, m.
pub trait ImplicitSurface: Send {
    /// Value of φ.
    fn value(&self, point: &Vector3<f64>) -> f64;

    /// Gradient ∂φ/∂p; not zero near the surface.
    fn gradient(&self, point: &Vector3<f64>) -> Vector3<f64>;

    /// Hessian ∂²φ/∂p².
    fn hessian(&self, point: &Vector3<f64>) -> Matrix3<f64>;

    /// Unit normal, eq. (1), out of the material.
    fn normal(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.gradient(point).normalize()
    }

    /// N = ∂n/∂p of eq. (21), 1/m.
    fn normal_change(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let gradient = self.gradient(point);
        let size = gradient.norm();
        let normal = gradient / size;
        (Matrix3::identity() - normal * normal.transpose()) * self.hessian(point) / size
    }

    /// φ divided by the norm of the gradient: the distance to first order, m. Its derivative by the
    /// point is the unit normal where φ is small.
    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.value(point) / self.gradient(point).norm()
    }

    /// Point of the surface closest to `point`, by Newton steps along the gradient.
    fn closest(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let mut at = *point;
        for _ in 0..4 {
            let gradient = self.gradient(&at);
            at -= gradient * (self.value(&at) / gradient.norm_squared());
        }
        at
    }
}

/// Shapes that can be named in a file. Other shapes implement [`ImplicitSurface`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case", deny_unknown_fields)]
pub enum ObjectShape {
    /// z = 0, material below: the paper's `nᵀp = 0`. With braces, so that unknown keys are refused.
    Plane {},
    /// Cylinder around the object's z axis.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
    },
    /// Sphere around the object's origin.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
}

impl ImplicitSurface for ObjectShape {
    fn value(&self, p: &Vector3<f64>) -> f64 {
        match self {
            Self::Plane {} => p.z,
            Self::Cylinder { radius_m } => p.xy().norm() - radius_m,
            Self::Sphere { radius_m } => p.norm() - radius_m,
        }
    }

    fn gradient(&self, p: &Vector3<f64>) -> Vector3<f64> {
        let unit = |v: Vector3<f64>| v.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        match self {
            Self::Plane {} => Vector3::z(),
            Self::Cylinder { .. } => unit(Vector3::new(p.x, p.y, 0.0)),
            Self::Sphere { .. } => unit(*p),
        }
    }

    fn hessian(&self, p: &Vector3<f64>) -> Matrix3<f64> {
        let out = self.gradient(p);
        match self {
            Self::Plane {} => Matrix3::zeros(),
            Self::Cylinder { .. } => {
                let around = Vector3::z().cross(&out);
                around * around.transpose() / p.xy().norm().max(1e-9)
            }
            Self::Sphere { .. } => {
                (Matrix3::identity() - out * out.transpose()) / p.norm().max(1e-9)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A paraboloid whose φ is not a distance: the general case.
    struct Bowl;

    impl ImplicitSurface for Bowl {
        fn value(&self, p: &Vector3<f64>) -> f64 {
            3.0 * (p.z - p.x * p.x - 0.5 * p.y * p.y)
        }
        fn gradient(&self, p: &Vector3<f64>) -> Vector3<f64> {
            Vector3::new(-6.0 * p.x, -3.0 * p.y, 3.0)
        }
        fn hessian(&self, _: &Vector3<f64>) -> Matrix3<f64> {
            Matrix3::from_diagonal(&Vector3::new(-6.0, -3.0, 0.0))
        }
    }

    fn derivatives_agree(surface: &dyn ImplicitSurface, p: &Vector3<f64>) {
        let h = 1e-6;
        for i in 0..3 {
            let mut step = Vector3::zeros();
            step[i] = h;
            let slope = (surface.value(&(p + step)) - surface.value(&(p - step))) / (2.0 * h);
            assert!((slope - surface.gradient(p)[i]).abs() < 1e-7);
            let turn = (surface.gradient(&(p + step)) - surface.gradient(&(p - step))) / (2.0 * h);
            assert!((turn - surface.hessian(p).column(i)).amax() < 1e-6);
            let turn = (surface.normal(&(p + step)) - surface.normal(&(p - step))) / (2.0 * h);
            assert!((turn - surface.normal_change(p).column(i)).amax() < 1e-6);
        }
    }

    proptest! {
        #[test]
        fn gradient_hessian_and_normal_are_the_derivatives(p in prop::array::uniform3(0.1f64..0.5)) {
            let p = Vector3::from(p);
            for shape in [ObjectShape::Plane {}, ObjectShape::Cylinder { radius_m: 0.2 }, ObjectShape::Sphere { radius_m: 0.3 }] {
                derivatives_agree(&shape, &p);
                prop_assert!(shape.value(&shape.closest(&p)).abs() < 1e-12);
            }
            derivatives_agree(&Bowl, &p);
            prop_assert!(Bowl.value(&Bowl.closest(&p)).abs() < 1e-6);
        }
    }

    #[test]
    fn unknown_keys_of_every_shape_are_refused() {
        for shape in ["shape = \"plane\"", "shape = \"sphere\"\nradius_m = 0.1"] {
            toml::from_str::<ObjectShape>(shape).unwrap();
            let error = toml::from_str::<ObjectShape>(&format!("{shape}\nwidth_m = 1.0"));
            assert!(error.unwrap_err().to_string().contains("width_m"));
        }
    }
}
