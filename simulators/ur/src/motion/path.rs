//! Lines and circular arcs of the tool centre point, with its orientation.

use nalgebra::{UnitQuaternion, Vector3};
use tangent_urscript::pose::{SixPose, interpolate, isometry};

/// Way of a planned motion, base axes.
#[derive(Clone, Debug)]
pub struct Path {
    from: SixPose,
    to: SixPose,
    arc: Option<Arc>,
}

#[derive(Clone, Debug)]
struct Arc {
    centre: Vector3<f64>,
    /// Rotation vector from the start to the end of the arc, rad.
    turn: Vector3<f64>,
    radius_m: f64,
    follows: bool,
}

impl Path {
    /// A straight line.
    pub fn line(from: SixPose, to: SixPose) -> Self {
        Self {
            from,
            to,
            arc: None,
        }
    }

    /// An arc through the position of `via`; a line if the three points are on one. With `follows`
    /// the orientation turns with the arc, and that of `to` does not count.
    pub fn arc(from: SixPose, via: &SixPose, to: SixPose, follows: bool) -> Self {
        let point = |p: &SixPose| Vector3::new(p[0], p[1], p[2]);
        let (a, b, c) = (point(&from), point(via), point(&to));
        let (u, v) = (b - a, c - a);
        let normal = u.cross(&v);
        let size = normal.norm_squared();
        if size < 1e-12 * u.norm_squared().max(v.norm_squared()) {
            return Self::line(from, to);
        }
        // Centre of the circle through three points.
        let offset = (v.norm_squared() * normal.cross(&u) - u.norm_squared() * normal.cross(&v))
            / (2.0 * size);
        let centre = a + offset;
        let (start, end) = (-offset, c - centre);
        // Seen along the normal, the points follow each other counterclockwise.
        let axis = normal / size.sqrt();
        let mut angle = axis.dot(&start.cross(&end)).atan2(start.dot(&end));
        if angle <= 0.0 {
            angle += std::f64::consts::TAU;
        }
        let mut path = Self {
            from,
            to,
            arc: Some(Arc {
                centre,
                turn: axis * angle,
                radius_m: offset.norm(),
                follows,
            }),
        };
        if follows {
            path.to = path.at(1.0);
        }
        path
    }

    /// Length, m. A turn on the spot counts its angle, rad: it runs at as many rad/s as a line at
    /// m/s.
    pub fn length(&self) -> f64 {
        let (linear, angular) = apart(&self.from, &self.to);
        let linear = match &self.arc {
            Some(arc) => arc.radius_m * arc.turn.norm(),
            None => linear.norm(),
        };
        linear.max(angular.norm())
    }

    /// The pose after a share of the way, 0 to 1.
    pub fn at(&self, share: f64) -> SixPose {
        let mut pose = interpolate(&self.from, &self.to, share);
        if let Some(arc) = &self.arc {
            let turned = UnitQuaternion::from_scaled_axis(arc.turn * share);
            let from = isometry(&self.from);
            let position = arc.centre + turned * (from.translation.vector - arc.centre);
            pose[..3].copy_from_slice(position.as_slice());
            if arc.follows {
                let rotation = (turned * from.rotation).scaled_axis();
                pose[3..].copy_from_slice(rotation.as_slice());
            }
        }
        pose
    }
}

/// From one pose to another: translation and rotation vector, base axes.
pub fn apart(from: &SixPose, to: &SixPose) -> (Vector3<f64>, Vector3<f64>) {
    let (from, to) = (isometry(from), isometry(to));
    (
        to.translation.vector - from.translation.vector,
        (to.rotation * from.rotation.inverse()).scaled_axis(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arc_passes_its_points_at_its_radius() {
        let from = [0.1, 0.0, 0.5, 0.0, 0.0, 0.0];
        let via = [0.0, 0.1, 0.5, 0.0, 0.0, 0.0];
        // Three quarters of a circle around the z axis.
        let to = [0.0, -0.1, 0.5, 0.0, 0.0, 0.3];
        let path = Path::arc(from, &via, to, false);
        let length = 0.1 * 1.5 * std::f64::consts::PI;
        assert!((path.length() - length).abs() < 1e-9);
        let close = |a: SixPose, b: SixPose| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-9);
        assert!(close(path.at(0.0), from) && close(path.at(1.0), to));
        assert!(close(path.at(1.0 / 3.0), [0.0, 0.1, 0.5, 0.0, 0.0, 0.1]));

        let following = Path::arc(from, &via, to, true);
        let quarter = following.at(1.0 / 3.0);
        assert!((quarter[5] - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    }

    #[test]
    fn three_points_on_a_line_are_a_line() {
        let point = |x: f64| [x, 0.0, 0.0, 0.0, 0.0, 0.0];
        let path = Path::arc(point(0.0), &point(0.5), point(1.0), false);
        assert!((path.length() - 1.0).abs() < 1e-12);
    }
}
