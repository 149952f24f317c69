//! Paths in a plane, as a task specifies them, with a smooth time law.
//!
//! A path starts at the origin (where the tool touched down) and is drawn in the plane's x and y.
//! The controller maps the plane to the surface: see `tracking`.

mod ahead;
mod drawing;
mod force_profile;
mod lift;
mod places;
mod pressing;
pub(crate) mod ranges;
mod shape;
mod spec;
mod stroke_way;
mod strokes;
mod turns;

use nalgebra::Vector2;

use crate::task::profile::Profile;
use shape::Shape;

pub(crate) use force_profile::{FORCE_N, check_force_profile};
pub(crate) use lift::{Lift, Rise};
pub use places::PathPlace;
pub use shape::PathPoint;
pub use spec::{Circle, Line, PathSpec, Raster, Stay, Waypoints};
pub(crate) use stroke_way::StrokeWay;
pub use strokes::{StrokeSpec, Strokes};

#[derive(Clone, Copy, Debug)]
struct Stretch {
    start_s: f64,
    shape: Shape,
    profile: Profile,
    pressing: Pressing,
}

/// Pressing force of a stretch.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Pressing {
    /// The task's.
    OfTask,
    /// N.
    Constant(f64),
    /// `count` places of the path's profiles from `first`; the stretch begins `offset_m` along
    /// them.
    Profile {
        first: usize,
        count: usize,
        offset_m: f64,
    },
}

/// A path with its time law; made once, then read every cycle.
///
/// ```
/// use nalgebra::Vector2;
/// use tangent_control::{Circle, Path, PathSpec};
///
/// let circle = PathSpec::Circle(Circle { radius_m: 0.05, turns: 1.0, speed_m_per_s: 0.03 });
/// // Within 0.1 m/s² and 1 m/s³ along the path.
/// let path = Path::new(&circle, 0.1, 1.0)?;
///
/// // Half way round, the tool is at the other end of the diameter, at full speed.
/// let half = path.at(0.5 * path.duration_s());
/// assert!((half.position - Vector2::new(0.1, 0.0)).norm() < 1e-9);
/// assert!((half.velocity.norm() - 0.03).abs() < 1e-9);
/// # Ok::<(), tangent_control::ControlError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Path {
    stretches: Vec<Stretch>,
    /// Points of chains, and the way to each from the first of its chain, m.
    points: Vec<(Vector2<f64>, f64)>,
    lifts: Vec<Lift>,
    /// Places of force profiles: way, m, and force, N.
    profiles: Vec<[f64; 2]>,
    rise: Rise,
    duration_s: f64,
}

impl Path {
    /// A path without a stroke.
    fn empty(rise: Rise) -> Self {
        Self {
            stretches: Vec::new(),
            points: Vec::new(),
            lifts: Vec::new(),
            profiles: Vec::new(),
            rise,
            duration_s: 0.0,
        }
    }

    fn straight(&mut self, from: Vector2<f64>, to: Vector2<f64>, speed: f64, bounds: (f64, f64)) {
        let length = (to - from).norm();
        if length > 0.0 {
            self.push(
                Shape::Straight {
                    from,
                    direction: (to - from) / length,
                },
                Profile::new(length, speed, bounds.0, bounds.1),
            );
        }
    }

    fn push(&mut self, shape: Shape, profile: Profile) {
        self.stretches.push(Stretch {
            start_s: self.duration_s,
            shape,
            profile,
            pressing: Pressing::OfTask,
        });
        self.duration_s += profile.duration_s();
    }

    /// Lengths of the strokes, m: the parts of the path that start and end at rest. For `loops`,
    /// that of a tool at the highest speed of the policy.
    pub fn stroke_lengths_m(&self) -> impl Iterator<Item = f64> + '_ {
        self.stretches.iter().map(Stretch::length_m)
    }

    /// Index of the stroke at `time_s`, and the distance along it, m; `None` before the first one.
    pub fn stroke_at(&self, time_s: f64) -> Option<(usize, f64)> {
        let time_s = time_s.min(self.duration_s);
        let index = (self.stretches).partition_point(|stretch| stretch.start_s <= time_s);
        let index = index.checked_sub(1)?;
        let stretch = &self.stretches[index];
        let (distance, _) = stretch.profile.at(time_s - stretch.start_s);
        Some((index, distance * stretch.shape.metres_per_unit()))
    }

    /// Duration of the path at nominal speed, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Position and velocity at `time_s`; at rest before the start and after the end.
    pub fn at(&self, time_s: f64) -> PathPoint {
        let time_s = time_s.min(self.duration_s);
        let index = self
            .stretches
            .partition_point(|stretch| stretch.start_s <= time_s);
        let Some(stretch) = index.checked_sub(1).and_then(|i| self.stretches.get(i)) else {
            return PathPoint {
                position: Vector2::zeros(),
                velocity: Vector2::zeros(),
            };
        };
        let (distance, speed) = stretch.profile.at(time_s - stretch.start_s);
        stretch.shape.at(&self.points, distance, speed)
    }
}

impl Stretch {
    /// Length, m.
    fn length_m(&self) -> f64 {
        self.profile.at(f64::INFINITY).0 * self.shape.metres_per_unit()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn path(toml: &str) -> Path {
        let spec: PathSpec = toml::from_str(toml).unwrap();
        Path::new(&spec, 0.1, 1.0).unwrap()
    }

    fn end(path: &Path) -> Vector2<f64> {
        path.at(path.duration_s()).position
    }

    #[test]
    fn the_papers_raster_takes_thirty_seconds_and_stays_in_its_square() {
        let raster = path(
            "kind = \"raster\"\nlength_m = 0.2\nstep_m = 0.2\nspeed_m_per_s = 0.02\npause_s = 0.5\nduration_s = 30.0",
        );
        assert_eq!(raster.duration_s(), 30.0);
        for i in 0..3000 {
            let p = raster.at(f64::from(i) * 0.01).position;
            assert!((-1e-12..=0.2 + 1e-12).contains(&p.x) && (-1e-12..=0.2 + 1e-12).contains(&p.y));
        }
        assert!((raster.at(10.6).position - Vector2::new(0.2, 0.0)).norm() < 1e-9);
        assert_eq!(raster.at(10.6).velocity.norm(), 0.0);
    }

    #[test]
    fn ends_are_where_they_were_drawn() {
        let circle = path("kind = \"circle\"\nradius_m = 0.05\nspeed_m_per_s = 0.03\nturns = -1.0");
        assert!(end(&circle).norm() < 1e-12);
        assert!(
            (circle.at(circle.duration_s() / 2.0).position - Vector2::new(0.1, 0.0)).norm() < 1e-9
        );
        let line = path("kind = \"line\"\nto_m = [0.03, -0.04]\nspeed_m_per_s = 0.02\nstrokes = 3");
        assert!((end(&line) - Vector2::new(0.03, -0.04)).norm() < 1e-12);
        let points = path(
            "kind = \"waypoints\"\npoints_m = [[0.1, 0.0], [0.1, 0.0], [0.0, 0.1]]\nspeed_m_per_s = 0.02",
        );
        assert!((end(&points) - Vector2::new(0.0, 0.1)).norm() < 1e-12);
        let stay = path("kind = \"stay\"\nduration_s = 2.0");
        assert_eq!((end(&stay), stay.duration_s()), (Vector2::zeros(), 2.0));
    }

    #[test]
    fn the_wiping_policy_is_the_published_one_but_for_its_start_and_end() {
        let loops = path(
            "kind = \"loops\"\nradius_m = 0.04\nturn_rate_rad_per_s = 2.0\nadvance_m_per_s = 0.005\nduration_s = 20.0",
        );
        let policy = |t: f64| {
            Vector2::new(
                0.04 * (2.0 * t).sin(),
                0.04 * ((2.0 * t).cos() - 1.0) - 0.005 * t,
            )
        };
        let ramp = loops.duration_s() - 20.0;
        assert!(ramp > 0.1 && ramp < 2.0, "{ramp}");
        // The acceleration takes one ramp and covers half of its time.
        for t in [2.0, 7.3, 15.0] {
            let now = loops.at(t + 0.5 * ramp);
            assert!((now.position - policy(t)).norm() < 1e-12);
            let slope = (policy(t + 1e-6) - policy(t - 1e-6)) / 2e-6;
            assert!((now.velocity - slope).norm() < 1e-8);
        }
        assert!((end(&loops) - policy(20.0)).norm() < 1e-12);
        assert_eq!(loops.at(0.0).velocity.norm(), 0.0);
    }

    #[test]
    fn unknown_keys_of_a_kind_are_errors() {
        let text = "kind = \"circle\"\nradius_m = 0.05\nspeed_m_per_s = 0.03\nlength_m = 1.0";
        let error = toml::from_str::<PathSpec>(text).unwrap_err().to_string();
        assert!(error.contains("length_m"), "{error}");
    }

    proptest! {
        #[test]
        fn speed_and_acceleration_stay_bounded(points in prop::collection::vec(prop::array::uniform2(-0.3f64..0.3), 1..6),
                                               speed in 0.005f64..0.1) {
            let spec = PathSpec::Waypoints(Waypoints { points_m: points, speed_m_per_s: speed, pause_s: 0.1 });
            let path = Path::new(&spec, 0.1, 1.0).unwrap();
            let h = 0.004;
            let mut before = path.at(0.0);
            let mut t = 0.0;
            while t < path.duration_s() + 0.1 {
                t += h;
                let now = path.at(t);
                prop_assert!(now.velocity.norm() <= speed * (1.0 + 1e-9));
                prop_assert!((now.velocity - before.velocity).norm() / h <= 0.1 * (1.0 + 1e-6));
                prop_assert!((now.position - before.position).norm() <= speed * h * (1.0 + 1e-6));
                before = now;
            }
        }

        #[test]
        fn a_circle_stays_on_its_circle(radius in 0.01f64..0.3, speed in 0.005f64..0.2, t in 0.0f64..1.0) {
            let spec = PathSpec::Circle(Circle { radius_m: radius, turns: 1.5, speed_m_per_s: speed });
            let path = Path::new(&spec, 0.1, 1.0).unwrap();
            let at = path.at(t * path.duration_s());
            prop_assert!(((at.position - Vector2::new(radius, 0.0)).norm() - radius).abs() < 1e-9);
            // Centripetal acceleration within the bound.
            prop_assert!(at.velocity.norm_squared() / radius <= 0.1 * (1.0 + 1e-9));
        }
    }
}
