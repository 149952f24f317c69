//! Intersection of a ray with a shape's material, for the simulated depth camera.

use nalgebra::Vector3;

use super::graph::Graph;

/// Points `origin + t direction`, in a shape's own axes (m); `direction` need not be a unit vector.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_simulation::surfaces::{Ray, Shape, Sphere};
///
/// let ray = Ray { origin: Vector3::new(0.0, 0.0, 1.0), direction: -Vector3::z() };
/// let hit = Sphere::new(0.1).enter(&ray, [0.0, 2.0]);
/// assert!((hit.unwrap() - 0.9).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Point at `t = 0`, m.
    pub origin: Vector3<f64>,
    /// Displacement per unit of `t`, m.
    pub direction: Vector3<f64>,
}

impl Ray {
    /// The point at `t`.
    pub fn at(&self, t: f64) -> Vector3<f64> {
        self.origin + self.direction * t
    }

    /// The first `t` that lies in both `range` and `inside`.
    pub(super) fn first(range: [f64; 2], inside: [f64; 2]) -> Option<f64> {
        let t = range[0].max(inside[0]);
        (t <= range[1].min(inside[1])).then_some(t)
    }
}

/// Both roots of `a t² + 2 b t + c`, the smaller first; `None` if they are not real or `a` is zero.
pub(super) fn roots(a: f64, b: f64, c: f64) -> Option<[f64; 2]> {
    let discriminant = b * b - a * c;
    if a == 0.0 || discriminant < 0.0 {
        return None;
    }
    // The root without cancellation first.
    let q = -(b + discriminant.sqrt().copysign(b));
    let (one, two) = (q / a, if q == 0.0 { 0.0 } else { c / q });
    Some([one.min(two), one.max(two)])
}

/// Maximum number of steps; a ray that grazes a surface for longer counts as a miss.
const STEPS_MAX: usize = 2000;
/// Minimum step length, m: thinner material may be stepped over.
const NEAR_M: f64 = 1e-4;
/// Clearance at which the ray counts as having arrived, m.
const ARRIVED_M: f64 = 1e-9;

/// Sphere tracing; `distance` must not exceed the true distance outside the material.
pub(super) fn march(
    ray: &Ray,
    [from, to]: [f64; 2],
    distance: impl Fn(&Vector3<f64>) -> f64,
) -> Option<f64> {
    let speed = ray.direction.norm();
    walk([from, to], |t| distance(&ray.at(t)), speed)
}

/// Marches along the ray down to a height over the plane. The rate of change of the clearance along
/// the ray is bounded, which bounds each step.
pub(super) fn march_graph<G: Graph>(graph: &G, ray: &Ray, [from, to]: [f64; 2]) -> Option<f64> {
    let along = (ray.direction.x * ray.direction.x + ray.direction.y * ray.direction.y).sqrt();
    let rate = ray.direction.z.abs() + graph.slope_max() * along;
    let clearance = |t: f64| {
        let p = ray.at(t);
        p.z - graph.height(p.x, p.y).0
    };
    walk([from, to], clearance, rate)
}

/// Marches along the ray; `rate` bounds how fast `clearance` decreases with `t`.
fn walk([from, to]: [f64; 2], clearance: impl Fn(f64) -> f64, rate: f64) -> Option<f64> {
    let mut t = from;
    let mut f = clearance(t);
    if f <= 0.0 {
        return Some(from);
    }
    for _ in 0..STEPS_MAX {
        let next = (t + f.max(NEAR_M) / rate).min(to);
        let there = clearance(next);
        if there <= 0.0 {
            return Some(crossing([t, f], [next, there], &clearance));
        }
        if next >= to {
            return None;
        }
        (t, f) = (next, there);
    }
    None
}

/// Crossing between a point outside and one inside, by regula falsi with the Illinois modification.
fn crossing(mut outside: [f64; 2], mut inside: [f64; 2], clearance: &impl Fn(f64) -> f64) -> f64 {
    for _ in 0..60 {
        let t = outside[0] + (inside[0] - outside[0]) * outside[1] / (outside[1] - inside[1]);
        let f = clearance(t);
        if f.abs() <= ARRIVED_M {
            return t;
        }
        if f > 0.0 {
            outside = [t, f];
            inside[1] *= 0.5;
        } else {
            inside = [t, f];
            outside[1] *= 0.5;
        }
    }
    inside[0]
}
