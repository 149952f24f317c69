//! A normal with its uncertainty: an arrow, and a cone in which the true normal lies with 95 %.

use nalgebra::{Matrix2, Matrix3, SymmetricEigen, Vector3};
use tangent_schemas::standard::{Duration, Marker, Point};
use tangent_schemas::tangent::NormalEstimate;

use super::NORMAL_M;
use super::shape::{arrow, kind, marker};
use crate::pressed::cross_axes;

/// Radius of the 95 % region of two normally distributed angles, in standard deviations.
const CHI: f64 = 2.447_746_8;
/// Widest half angle drawn, rad: beyond it, nothing is known of the normal.
const HALF_ANGLE_MAX_RAD: f64 = 1.2;
/// Triangles of a cone.
const SIDES: usize = 16;
/// Time after which a normal without a successor disappears, ns.
const LIFETIME_NS: u32 = 600_000_000;

/// Arrow and cone of an estimate; nothing if it is not valid. That of the estimator in use is blue,
/// others are grey.
pub fn of_estimate(name: &str, estimate: &NormalEstimate, in_use: &str) -> Vec<Marker> {
    let normal = Vector3::from(&estimate.normal);
    let point = Vector3::from(&estimate.point);
    let finite = point.iter().chain(normal.iter()).all(|x| x.is_finite());
    let Some(normal) = normal.try_normalize(1e-6).filter(|_| finite) else {
        return Vec::new();
    };
    if estimate.validity != 0 {
        return Vec::new();
    }
    let stamp = estimate.header.stamp.to_ns();
    let color = if name == in_use {
        [0.1, 0.4, 1.0]
    } else {
        [0.6, 0.6, 0.65]
    };
    let along = normal * NORMAL_M;
    let mut shapes = vec![arrow(
        stamp,
        &format!("estimate/{name}"),
        point,
        along,
        color,
    )];
    if let Some(points) = cone(&point, &normal, &estimate.covariance) {
        let name = format!("uncertainty/{name}");
        let mut cone = marker(stamp, "base", &name, kind::TRIANGLE_LIST, color);
        (cone.scale.x, cone.scale.y, cone.scale.z) = (1.0, 1.0, 1.0);
        cone.color.a = 0.35;
        cone.points = points;
        shapes.push(cone);
    }
    for shape in &mut shapes {
        shape.lifetime = Duration {
            sec: 0,
            nanosec: LIFETIME_NS,
        };
    }
    shapes
}

/// Triangles of the cone about the normal; `None` if the covariance is not one.
fn cone(point: &Vector3<f64>, normal: &Vector3<f64>, covariance: &[f64; 9]) -> Option<Vec<Point>> {
    let covariance = Matrix3::from_row_slice(covariance);
    let (x, y) = cross_axes(normal);
    // The normal moves in the tangent plane only.
    let of = |a: &Vector3<f64>, b: &Vector3<f64>| a.dot(&(covariance * b));
    let plane = Matrix2::new(of(&x, &x), of(&x, &y), of(&y, &x), of(&y, &y));
    if !plane.iter().all(|x| x.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(plane);
    let half = eigen.eigenvalues.map(|variance| {
        let angle = CHI * variance.max(0.0).sqrt();
        NORMAL_M * angle.min(HALF_ANGLE_MAX_RAD).tan()
    });
    let axis = |i: usize| x * eigen.eigenvectors[(0, i)] + y * eigen.eigenvectors[(1, i)];
    let (first, second) = (axis(0) * half[0], axis(1) * half[1]);
    let rim = |i: usize| {
        let (s, c) = (std::f64::consts::TAU * i as f64 / SIDES as f64).sin_cos();
        point + normal * NORMAL_M + first * c + second * s
    };
    let triangles = (0..SIDES).flat_map(|i| [*point, rim(i), rim((i + 1) % SIDES)]);
    Some(triangles.map(|corner| (&corner).into()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard deviations of 0.1 rad towards x and 0.02 rad towards y.
    fn estimate() -> NormalEstimate {
        let mut estimate = NormalEstimate {
            normal: (&Vector3::z()).into(),
            point: (&Vector3::new(0.5, 0.0, 0.2)).into(),
            ..NormalEstimate::default()
        };
        estimate.covariance[0] = 0.01;
        estimate.covariance[4] = 0.0004;
        estimate
    }

    #[test]
    fn the_cone_is_as_wide_as_the_covariance_says() {
        let shapes = of_estimate("blend", &estimate(), "blend");
        let cone = &shapes[1];
        assert_eq!(cone.r#type, kind::TRIANGLE_LIST);
        assert_eq!(cone.points.len(), 3 * SIDES);
        let wide = |of: &dyn Fn(&Point) -> f64| cone.points.iter().map(of).fold(0.0, f64::max);
        let (x, y) = (wide(&|p| (p.x - 0.5).abs()), wide(&|p| p.y.abs()));
        assert!((x - NORMAL_M * (0.1 * CHI).tan()).abs() < 1e-9, "{x}");
        assert!((y - NORMAL_M * (0.02 * CHI).tan()).abs() < 1e-9, "{y}");
        assert_ne!(
            shapes[0].color,
            of_estimate("blend", &estimate(), "other")[0].color
        );
    }

    #[test]
    fn what_is_no_normal_is_not_drawn() {
        let invalid = NormalEstimate {
            validity: 2,
            ..estimate()
        };
        assert!(of_estimate("blend", &invalid, "blend").is_empty());
        let mut not_a_number = estimate();
        not_a_number.normal.x = f64::NAN;
        assert!(of_estimate("blend", &not_a_number, "blend").is_empty());
        let mut unknown = estimate();
        unknown.covariance = [f64::NAN; 9];
        assert_eq!(of_estimate("blend", &unknown, "blend").len(), 1);
        unknown.covariance = [1e9, 0.0, 0.0, 0.0, 1e9, 0.0, 0.0, 0.0, 1e9];
        let widest = NORMAL_M * HALF_ANGLE_MAX_RAD.tan();
        let shapes = of_estimate("blend", &unknown, "blend");
        assert!(shapes[1].points.iter().all(|p| p.y.abs() <= widest + 1e-9));
    }
}
