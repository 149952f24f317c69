//! A cone around the local z axis: the side of a traffic cone, continued without base and tip
//! radius.

use nalgebra::{Matrix3, Vector3};

use super::cylinder::radial;
use super::ray::{Ray, roots};
use super::shape::Shape;

/// Material inside the side of the cone whose tip is at `z = height` and whose radius at `z = 0` is
/// `base_radius`.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    height: f64,
    slope: f64,
    cos: f64,
    sin: f64,
}

impl Cone {
    /// Height of the tip and radius at `z = 0`, m.
    pub fn new(height: f64, base_radius: f64) -> Self {
        let slant = height.hypot(base_radius);
        Self {
            height,
            slope: base_radius / height,
            cos: height / slant,
            sin: base_radius / slant,
        }
    }
}

impl Shape for Cone {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (out, rho) = radial(point);
        let distance = (rho - (self.height - point.z) * self.slope) * self.cos;
        (distance, out * self.cos + Vector3::z() * self.sin)
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let (out, rho) = radial(point);
        let (distance, _) = self.distance_and_normal(point);
        // Meusnier: the circle around the axis has curvature 1/rho, whose component along the
        // normal is scaled by cos(half angle).
        let rho_on_surface = (rho - distance * self.cos).max(1e-6);
        let around = Vector3::z().cross(&out);
        around * around.transpose() * (self.cos / rho_on_surface)
    }

    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        // Inside where x² + y² <= (slope below)² and below = height - z >= 0.
        let (o, d) = (&ray.origin, &ray.direction);
        let below = [self.height - o.z, -d.z];
        let s2 = self.slope * self.slope;
        let a = d.xy().norm_squared() - s2 * below[1] * below[1];
        let b = o.xy().dot(&d.xy()) - s2 * below[0] * below[1];
        let c = o.xy().norm_squared() - s2 * below[0] * below[0];
        let under = |t: f64| below[0] + below[1] * t >= 0.0;
        let inside = match roots(a, b, c) {
            Some([one, two]) if a > 0.0 => under(0.5 * (one + two)).then_some([one, two]),
            // Steeper than the side: one root on each half of the double cone; the lower half is
            // unbounded.
            Some([one, two]) => {
                if below[1] > 0.0 {
                    Some([two, f64::INFINITY])
                } else {
                    Some([f64::NEG_INFINITY, one])
                }
            }
            None if a < 0.0 => {
                let tip = -below[0] / below[1];
                if below[1] > 0.0 {
                    Some([tip, f64::INFINITY])
                } else {
                    Some([f64::NEG_INFINITY, tip])
                }
            }
            // Parallel to the side.
            None if a == 0.0 && b != 0.0 => {
                let t = -0.5 * c / b;
                if b < 0.0 {
                    under(t + 1.0).then_some([t, f64::INFINITY])
                } else {
                    under(t - 1.0).then_some([f64::NEG_INFINITY, t])
                }
            }
            None => None,
        };
        Ray::first(range, inside?)
    }
}
