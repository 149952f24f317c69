//! An ellipsoid around the local origin, with its axes along the local ones.

use nalgebra::{Matrix3, Vector3};

use super::shape::Shape;

/// Material inside `(x/a)² + (y/b)² + (z/c)² = 1`.
#[derive(Clone, Copy, Debug)]
pub struct Ellipsoid {
    semi_axes: Vector3<f64>,
}

/// Bisections of the search for the closest point: past this, the bracket is below the last digit.
const ROUNDS: usize = 120;

impl Ellipsoid {
    /// Ellipsoid with its semi-axes in m.
    pub fn new(semi_axes: [f64; 3]) -> Self {
        Self {
            semi_axes: semi_axes.into(),
        }
    }

    /// Closest point of the surface.
    ///
    /// The foot point `x` of `y` obeys `y = x + t grad / 2`, so `x_i = a_i² y_i / (t + a_i²)` with
    /// `t` the root of `sum (a_i y_i / (t + a_i²))² = 1` above `-min(a²)`. The sum decreases with
    /// `t` there, so a bracketed Newton iteration finds it from every start (Eberly, *Distance
    /// from a point to an ellipse, an ellipsoid, or a hyperellipsoid*, 2013).
    fn foot(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let a = &self.semi_axes;
        let squares = a.component_mul(a);
        // In the plane of symmetry of the shortest axis the root may be at the pole; a point that
        // is off the plane by less than the last digit that matters has the same distance.
        let y = point.map(|x| if x.abs() < 1e-12 { 1e-12 } else { x });
        let sum = |t: f64| {
            (0..3).fold((0.0, 0.0), |(value, slope), i| {
                let term = a[i] * y[i] / (t + squares[i]);
                (
                    value + term * term,
                    slope - 2.0 * term * term / (t + squares[i]),
                )
            })
        };
        // At the lower end the largest of the terms alone is at least 1; at the upper end the sum
        // is at most 1.
        let lower = (0..3)
            .map(|i| a[i] * y[i].abs() - squares[i])
            .fold(f64::NEG_INFINITY, f64::max);
        let upper = a.component_mul(&y).norm() - squares.min();
        let (mut low, mut high) = (lower, upper.max(lower));
        let mut t = low;
        for _ in 0..ROUNDS {
            let (value, slope) = sum(t);
            if value >= 1.0 {
                low = t;
            } else {
                high = t;
            }
            let newton = t - (value - 1.0) / slope;
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
            if (next - t).abs() <= 1e-15 * (1.0 + t.abs()) {
                break;
            }
            t = next;
        }
        Vector3::from_fn(|i, _| squares[i] * y[i] / (t + squares[i]))
    }

    /// Half of the gradient of the implicit function at a point of the surface.
    fn gradient(&self, on: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|i, _| on[i] / (self.semi_axes[i] * self.semi_axes[i]))
    }
}

impl Shape for Ellipsoid {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let foot = self.foot(point);
        let normal = self.gradient(&foot).normalize();
        (normal.dot(&(point - foot)), normal)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let gradient = self.gradient(&self.foot(point));
        let length = gradient.norm();
        let normal = gradient / length;
        let second = Matrix3::from_diagonal(&self.semi_axes.map(|a| 1.0 / (a * a)));
        let project = Matrix3::identity() - normal * normal.transpose();
        project * second * project / length
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surfaces::Sphere;
    use proptest::prelude::*;

    /// Distance of a point from the nearest of many points of the ellipsoid.
    fn nearest_by_search(semi_axes: [f64; 3], p: &Vector3<f64>) -> f64 {
        let [a, b, c] = semi_axes;
        let at = |u: f64, v: f64| {
            let (su, cu) = u.sin_cos();
            let (sv, cv) = v.sin_cos();
            (Vector3::new(a * cu * cv, b * cu * sv, c * su) - p).norm()
        };
        let (mut best, mut centre) = (f64::INFINITY, (0.0, 0.0));
        let mut span = (std::f64::consts::FRAC_PI_2, std::f64::consts::PI);
        for _ in 0..12 {
            let from = centre;
            for i in -20..=20 {
                for j in -20..=20 {
                    let (u, v) = (
                        from.0 + span.0 * f64::from(i) / 20.0,
                        from.1 + span.1 * f64::from(j) / 20.0,
                    );
                    let distance = at(u, v);
                    if distance < best {
                        (best, centre) = (distance, (u, v));
                    }
                }
            }
            span = (span.0 * 0.2, span.1 * 0.2);
        }
        best
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn the_closest_point_of_an_ellipsoid_is_found_from_outside_and_from_inside(
            at in prop::array::uniform3(-0.5f64..0.5),
            semi_axes in prop::array::uniform3(0.05f64..0.4),
        ) {
            let ellipsoid = Ellipsoid::new(semi_axes);
            let p = Vector3::from(at);
            let (distance, normal) = ellipsoid.distance_and_normal(&p);
            let inside = (0..3).map(|i| (p[i] / semi_axes[i]).powi(2)).sum::<f64>() < 1.0;
            prop_assert_eq!(distance < 0.0, inside);
            prop_assert!((normal.norm() - 1.0).abs() < 1e-12);
            let searched = nearest_by_search(semi_axes, &p);
            prop_assert!((distance.abs() - searched).abs() < 1e-6, "{distance} m, {searched} m by search");
        }
    }

    #[test]
    fn an_ellipsoid_of_equal_axes_is_a_sphere_and_its_poles_have_their_radii() {
        let (ball, sphere) = (Ellipsoid::new([0.2; 3]), Sphere::new(0.2));
        for p in [
            Vector3::new(0.1, 0.2, 0.3),
            Vector3::new(0.0, 0.0, 0.21),
            Vector3::new(0.05, -0.02, 0.01),
        ] {
            let (a, b) = (ball.distance_and_normal(&p), sphere.distance_and_normal(&p));
            assert!((a.0 - b.0).abs() < 1e-12 && (a.1 - b.1).norm() < 1e-9);
            assert!((ball.curvature(&p) - sphere.curvature(&p)).norm() < 1e-6);
        }
        // At the pole of c the radii of curvature are a²/c and b²/c.
        let egg = Ellipsoid::new([0.3, 0.2, 0.1]);
        let pole = egg.curvature(&Vector3::new(0.0, 0.0, 0.11));
        assert!(
            (pole[(0, 0)] - 0.1 / 0.09).abs() < 1e-6 && (pole[(1, 1)] - 0.1 / 0.04).abs() < 1e-6
        );
    }
}
