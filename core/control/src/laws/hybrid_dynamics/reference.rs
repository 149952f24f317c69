//! Reference of the tool in object axes: down to the surface along its normal, then along the path
//! on it.

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use tangent_estimation::object_pose::ImplicitSurface;
use tangent_mechanics::{Object, Pose, Tool};

use super::estimate_follower::EstimateFollower;
use super::law::MotionReference;
use crate::task::path::Path;
use crate::task::profile::Profile;

/// Half the interval of the central differences along the path, s; the path's own profile is
/// smoother than that.
const DIFFERENCE_S: f64 = 0.004;
/// Limits of the rotation that aligns the tool with the normal during the approach.
const TURN_SPEED_RAD_PER_S: f64 = 0.2;
const TURN_ACCELERATION_RAD_PER_S2: f64 = 0.5;
const TURN_JERK_RAD_PER_S3: f64 = 5.0;

/// Reference state in object axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct ObjectReference {
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
    pub rotation: UnitQuaternion<f64>,
    pub angular: Vector3<f64>,
}

impl ObjectReference {
    /// Reference in base axes, including the motion of the pose in use.
    pub fn in_base(&self, object: &EstimateFollower) -> MotionReference {
        let pose = object.pose();
        MotionReference {
            position: pose.transform_point(&self.position),
            velocity: pose.rotate(&self.velocity)
                + object.velocity_at(&self.position, &self.position),
            acceleration: pose.rotate(&self.acceleration),
            rotation: pose.rotation() * self.rotation,
            angular: pose.rotate(&self.angular) + object.angular(),
        }
    }
}

/// `rotation` after the smallest rotation that points its z axis against `normal` (both in object
/// axes).
fn squared(rotation: &UnitQuaternion<f64>, normal: &Vector3<f64>) -> UnitQuaternion<f64> {
    let (z, wanted) = (rotation * Vector3::z(), -normal);
    let axis = z.cross(&wanted);
    // An arc cosine would lose half the digits of a small angle, and the path is differentiated.
    let angle = axis.norm().atan2(z.dot(&wanted));
    let axis = axis
        .try_normalize(1e-12)
        .unwrap_or_else(|| rotation * Vector3::x());
    let turn = UnitQuaternion::from_scaled_axis(axis * angle);
    turn * rotation
}

/// Motion straight down to the surface, during which the tool is aligned with the normal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Descent {
    start: Vector3<f64>,
    down: Vector3<f64>,
    way: Profile,
    from: UnitQuaternion<f64>,
    axis: Vector3<f64>,
    turn: Profile,
    time_s: f64,
    /// Distance beyond the end of the profile, m, and the speed there, m/s.
    further_m: f64,
    further_m_per_s: f64,
    /// Distance from the end of the profile to the estimated surface, m.
    band_m: f64,
}

impl Descent {
    /// Descent from the tool's pose (object axes) to `band_m` above the surface; `bounds` are
    /// acceleration and jerk.
    pub fn new(
        surface: &dyn ImplicitSurface,
        object_from_tool: &Pose<Object, Tool>,
        speed_m_per_s: f64,
        bounds: (f64, f64),
        band_m: f64,
    ) -> Self {
        let start = object_from_tool.translation();
        let height = (start - surface.closest(&start)).norm();
        let normal = surface.normal(&start);
        let band_m = band_m.min(0.8 * height);
        let from = object_from_tool.rotation();
        let turn = (squared(&from, &normal) * from.inverse()).scaled_axis();
        Self {
            start,
            down: -normal,
            way: Profile::new(height - band_m, speed_m_per_s, bounds.0, bounds.1),
            from,
            axis: turn.try_normalize(1e-12).unwrap_or_else(Vector3::x),
            turn: Profile::new(
                turn.norm(),
                TURN_SPEED_RAD_PER_S,
                TURN_ACCELERATION_RAD_PER_S2,
                TURN_JERK_RAD_PER_S3,
            ),
            time_s: 0.0,
            further_m: 0.0,
            further_m_per_s: 0.0,
            band_m,
        }
    }

    /// Distance by which the reference has passed the estimated surface, m.
    pub fn beyond_m(&self) -> f64 {
        self.further_m - self.band_m
    }

    /// Advances the time law by `share` of a period. After the end of the profile, the reference
    /// moves on at up to `seek_m_per_s`.
    pub fn step(&mut self, share: f64, seek_m_per_s: f64, acceleration: f64, dt_s: f64) {
        let dt = share * dt_s;
        self.time_s += dt;
        if self.time_s > self.way.duration_s().max(self.turn.duration_s()) {
            self.further_m_per_s = (self.further_m_per_s + acceleration * dt).min(seek_m_per_s);
            self.further_m += self.further_m_per_s * dt;
        }
    }

    pub fn at(&self, share: f64) -> ObjectReference {
        let (way, speed) = self.way.at(self.time_s);
        let (angle, rate) = self.turn.at(self.time_s);
        ObjectReference {
            position: self.start + self.down * (way + self.further_m),
            velocity: self.down * (speed + self.further_m_per_s) * share,
            acceleration: Vector3::zeros(),
            rotation: UnitQuaternion::from_scaled_axis(self.axis * angle) * self.from,
            angular: self.axis * (rate * share),
        }
    }
}

/// Path on the surface: defined in the tangent plane at the touchdown, and projected onto the
/// surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePath {
    start: Vector3<f64>,
    x: Vector3<f64>,
    y: Vector3<f64>,
    square: UnitQuaternion<f64>,
}

impl SurfacePath {
    /// Path from the surface point closest to `start`, its x axis as close to `x` as possible;
    /// `rotation` is the tool's. Object axes.
    pub fn new(
        surface: &dyn ImplicitSurface,
        start: &Vector3<f64>,
        x: &Vector3<f64>,
        rotation: &UnitQuaternion<f64>,
    ) -> Self {
        let start = surface.closest(start);
        let normal = surface.normal(&start);
        let across = |v: &Vector3<f64>| (v - normal * normal.dot(v)).try_normalize(1e-6);
        let x = across(x)
            .or_else(|| across(&Vector3::x()))
            .or_else(|| across(&Vector3::y()))
            .unwrap_or_else(Vector3::x);
        Self {
            start,
            x,
            y: normal.cross(&x),
            square: squared(rotation, &normal),
        }
    }

    fn point(&self, surface: &dyn ImplicitSurface, p: Vector2<f64>) -> Vector3<f64> {
        surface.closest(&(self.start + self.x * p.x + self.y * p.y))
    }

    /// Reference at `time_s` of the path, whose clock runs at `rate` of real time.
    pub fn at(
        &self,
        surface: &dyn ImplicitSurface,
        path: &Path,
        time_s: f64,
        rate: f64,
    ) -> ObjectReference {
        self.along(surface, |t| path.at(t).position, time_s, rate)
    }

    /// Reference at `time_s` of the exploration, whose clock runs at `rate` of real time.
    pub fn exploring(
        &self,
        surface: &dyn ImplicitSurface,
        exploration: &Exploration,
        rate: f64,
    ) -> ObjectReference {
        let at = |t: f64| exploration.at(t);
        self.along(surface, at, exploration.time_s, rate)
    }

    fn along(
        &self,
        surface: &dyn ImplicitSurface,
        path: impl Fn(f64) -> Vector2<f64>,
        time_s: f64,
        rate: f64,
    ) -> ObjectReference {
        let h = DIFFERENCE_S;
        let [before, at, after] =
            [time_s - h, time_s, time_s + h].map(|t| self.point(surface, path(t)));
        let rotation = squared(&self.square, &surface.normal(&at));
        let turned = |p: &Vector3<f64>| squared(&self.square, &surface.normal(p));
        let turn = (turned(&after) * turned(&before).inverse()).scaled_axis();
        ObjectReference {
            position: at,
            velocity: (after - before) * (rate / (2.0 * h)),
            acceleration: (after - at * 2.0 + before) * (rate * rate / (h * h)),
            rotation,
            angular: turn * (rate / (2.0 * h)),
        }
    }
}

/// A small circle through the touchdown point that shows the orientation of the surface: at rest,
/// friction hides the normal in the force, and one point has no tilt.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exploration {
    radius_m: f64,
    way: Profile,
    /// Time of its clock, s.
    time_s: f64,
}

impl Exploration {
    /// Circle of this radius; `bounds` are acceleration and jerk. It is as fast as both allow.
    pub fn new(radius_m: f64, bounds: (f64, f64)) -> Self {
        let (acceleration, jerk) = bounds;
        // The centripetal acceleration is v²/r, its jerk v³/r².
        let speed = (acceleration * radius_m)
            .sqrt()
            .min((jerk * radius_m * radius_m).cbrt());
        let length = std::f64::consts::TAU * radius_m;
        Self {
            radius_m,
            way: Profile::new(length, speed, acceleration, jerk),
            time_s: 0.0,
        }
    }

    /// Advances its clock by `dt_s`.
    pub fn step(&mut self, dt_s: f64) {
        self.time_s += dt_s;
    }

    pub fn is_done(&self) -> bool {
        self.time_s >= self.way.duration_s()
    }

    fn at(&self, time_s: f64) -> Vector2<f64> {
        let (sin, cos) = (self.way.at(time_s).0 / self.radius_m).sin_cos();
        Vector2::new(1.0 - cos, sin) * self.radius_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::path::PathSpec;
    use tangent_estimation::object_pose::ObjectShape;

    fn circle() -> Path {
        let spec: PathSpec =
            toml::from_str("kind = \"circle\"\nradius_m = 0.1\nspeed_m_per_s = 0.1").unwrap();
        Path::new(&spec, 0.3, 3.0).unwrap()
    }

    #[test]
    fn the_path_lies_on_every_surface_and_the_tool_stays_square() {
        for shape in [
            ObjectShape::Plane {},
            ObjectShape::Cylinder { radius_m: 0.4 },
            ObjectShape::Sphere { radius_m: 0.5 },
        ] {
            let start = shape.closest(&Vector3::new(0.45, 0.1, 0.05));
            let path = circle();
            let lay = SurfacePath::new(
                &shape,
                &start,
                &Vector3::new(0.1, 0.3, 1.0),
                &UnitQuaternion::identity(),
            );
            let mut before = lay.at(&shape, &path, 0.0, 1.0);
            let dt = 1e-3;
            for i in 1..6000 {
                let now = lay.at(&shape, &path, f64::from(i) * dt, 1.0);
                assert!(shape.value(&now.position).abs() < 1e-9);
                let z = now.rotation * Vector3::z();
                assert!((z + shape.normal(&now.position)).norm() < 1e-9, "{shape:?}");
                let moved = (now.position - before.position) / dt;
                assert!((moved - (now.velocity + before.velocity) / 2.0).norm() < 1e-4);
                let turned = (now.rotation * before.rotation.inverse()).scaled_axis() / dt;
                assert!((turned - (now.angular + before.angular) / 2.0).norm() < 1e-3);
                before = now;
            }
        }
    }

    #[test]
    fn the_exploration_is_a_circle_within_its_bounds_and_ends_where_it_began() {
        let bounds = (0.25, 2.5);
        let mut exploration = Exploration::new(0.008, bounds);
        let (dt, mut last, mut speed_before) = (1e-3, Vector2::zeros(), Vector2::zeros());
        let mut furthest = 0.0_f64;
        while !exploration.is_done() {
            exploration.step(dt);
            let at = exploration.at(exploration.time_s);
            let speed = (at - last) / dt;
            // Along the path and towards its centre, at the corner where both are largest.
            assert!((speed - speed_before).norm() / dt < 1.5 * bounds.0);
            furthest = furthest.max(at.norm());
            (last, speed_before) = (at, speed);
        }
        assert!((furthest - 0.016).abs() < 1e-5 && last.norm() < 1e-5);
        assert!(exploration.time_s < 1.6, "{}", exploration.time_s);
    }

    #[test]
    fn the_descent_ends_square_and_goes_on_slowly() {
        let from = Pose::new(
            Vector3::new(-0.17, 0.0, 0.12),
            UnitQuaternion::from_scaled_axis(Vector3::new(3.0, 0.1, -0.05)),
        );
        let mut descent = Descent::new(&ObjectShape::Plane {}, &from, 0.05, (0.1, 1.0), 0.02);
        assert!((descent.at(1.0).position - from.translation()).norm() < 1e-12);
        while descent.beyond_m() < 0.0 {
            descent.step(1.0, 0.01, 0.1, 1e-3);
        }
        let end = descent.at(1.0);
        assert!(end.position.z.abs() < 1e-4 && (end.position.x + 0.17).abs() < 1e-12);
        assert!((end.velocity.z + 0.01).abs() < 1e-9);
        assert!((end.rotation * Vector3::z() + Vector3::z()).norm() < 1e-9);
    }
}
