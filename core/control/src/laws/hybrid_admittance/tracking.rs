//! Follows a plane path on a curved surface.
//!
//! The path's plane is perpendicular to the approach direction. Each cycle the path velocity is
//! rotated from the plane into the tangent plane of the surface by the smallest rotation, so a
//! metre of path is a metre on the surface however steep it gets, and the reference point moves
//! with it. A path with an expected surface is drawn over the plane instead: each point is the
//! place of the surface above or below it, and the clock is slower where the surface is steep, so
//! that the speed along the surface is the path's. The position error is fed back in the tangent
//! plane. The path runs on its own clock: pause, speed, a lagging arm and a lost contact slow or
//! stop the clock, and the path continues from the same point.

use nalgebra::{UnitQuaternion, Vector2, Vector3};

use super::config::PathConfig;
use crate::contact::alignment::{plane_axes, tangential};
use crate::limits::clamp_norm;
use crate::task::path::{Lift, Path};

/// Time ahead on the path's own clock at which its direction is taken, s: before a corner the path
/// slows down for the direction after it.
const AHEAD_S: f64 = 0.1;
/// Least cosine of the angle between the surface and the plane over which a path is drawn.
const COSINE_MIN: f64 = 0.2;

/// Runs a path on a surface. Its state is the clock and the reference point.
#[derive(Clone, Copy, Debug)]
pub struct Tracking {
    x_axis: Vector3<f64>,
    y_axis: Vector3<f64>,
    plane_normal: Vector3<f64>,
    /// Whether points of the path are places over the plane instead of lengths along the surface.
    over_plane: bool,
    /// Place of the path's origin, m; base axes.
    origin: Vector3<f64>,
    clock_s: f64,
    clock_rate: f64,
    waiting: bool,
    /// Number of lifts behind the tool.
    lifts_done: usize,
    /// Displacement of the reference from the path, in the path's plane, m.
    aside: Vector2<f64>,
    /// Reference position of the tool on the path, base axes, m.
    pub reference: Vector3<f64>,
}

impl Tracking {
    /// A plane with `plane_normal` (unit, out of the material), x the projection of `x_axis`,
    /// starting at `start`, m; base axes.
    pub fn new(plane_normal: Vector3<f64>, x_axis: Vector3<f64>, start: Vector3<f64>) -> Self {
        let (x_axis, y_axis) = plane_axes(&plane_normal, &x_axis);
        Self {
            x_axis,
            y_axis,
            plane_normal,
            over_plane: false,
            origin: start,
            clock_s: 0.0,
            clock_rate: 0.0,
            waiting: false,
            lifts_done: 0,
            aside: Vector2::zeros(),
            reference: start,
        }
    }

    /// With points of the path that are places over the plane, if `over_plane`, instead of lengths
    /// along the surface.
    pub(crate) fn drawn_over_plane(self, over_plane: bool) -> Self {
        Self { over_plane, ..self }
    }

    /// Sets the path's start: where the tool touched down.
    pub fn begin_at(&mut self, start: Vector3<f64>) {
        self.reference = start;
        self.origin = start;
        self.restart();
    }

    /// Begins another path at the reference.
    pub(crate) fn restart(&mut self) {
        self.clock_s = 0.0;
        self.clock_rate = 0.0;
        self.lifts_done = 0;
        self.aside = Vector2::zeros();
    }

    /// Time on the path's own clock, s.
    pub(crate) fn clock_s(&self) -> f64 {
        self.clock_s
    }

    /// The lift that is due: the tool is at the end of a stroke.
    pub(crate) fn at_lift<'a>(&self, path: &'a Path) -> Option<&'a Lift> {
        let lift = path.lift(self.lifts_done)?;
        (self.clock_s >= lift.start_s).then_some(lift)
    }

    /// Where a tool that has left the surface lands, in the path's plane: at `past_s` on the path's
    /// clock, or after the lift that is due.
    pub(crate) fn landing(&self, path: &Path, past_s: Option<f64>) -> Option<Vector2<f64>> {
        match past_s {
            Some(past_s) => Some(path.at(past_s).position + self.aside),
            None => self.at_lift(path).map(|lift| lift.to),
        }
    }

    /// Time on the path's clock, s, at which it goes on past something that is `length_m` long.
    pub(crate) fn past_s(&self, path: &Path, length_m: f64) -> f64 {
        let end_s = path.slides_until_s(self.lifts_done);
        path.ahead_s(self.clock_s, end_s, length_m)
    }

    /// Goes on at `past_s`, or else at the end of the lift that is due, with the reference at
    /// `start` (m).
    pub(crate) fn land(&mut self, path: &Path, past_s: Option<f64>, start: Vector3<f64>) {
        if let Some(past_s) = past_s {
            self.clock_s = past_s;
        } else if let Some(lift) = path.lift(self.lifts_done) {
            self.clock_s = lift.end_s;
            self.lifts_done += 1;
        }
        self.clock_rate = 0.0;
        self.reference = start;
        self.aside = Vector2::zeros();
    }

    /// Displacement of the reference from the path, in the path's plane, m.
    pub(crate) fn aside(&self) -> Vector2<f64> {
        self.aside
    }

    /// Moves the reference to `reference` (m), displaced from the path by `aside` (m, path's
    /// plane).
    pub(crate) fn displace(&mut self, reference: Vector3<f64>, aside: Vector2<f64>) {
        self.clock_rate = 0.0;
        self.reference = reference;
        self.aside = aside;
    }

    /// Point of the path's plane for a tool at `position`, m.
    pub(crate) fn in_plane(
        &self,
        path: &Path,
        position: &Vector3<f64>,
        normal: &Vector3<f64>,
    ) -> Vector2<f64> {
        if self.over_plane {
            return self.flat(&(position - self.origin));
        }
        let off = tangential(&(position - self.reference), normal);
        let flat = match UnitQuaternion::rotation_between(normal, &self.plane_normal) {
            Some(rotation) => rotation * off,
            None => Vector3::zeros(),
        };
        path.at(self.clock_s).position + self.aside + self.flat(&flat)
    }

    fn flat(&self, v: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(v.dot(&self.x_axis), v.dot(&self.y_axis))
    }

    /// Point of the path's plane below or above a place, for a path drawn over the plane, m.
    pub(crate) fn over(&self, position: &Vector3<f64>) -> Vector2<f64> {
        self.flat(&(position - self.origin))
    }

    /// Height of a place over the path's plane, m.
    pub(crate) fn height_m(&self, position: &Vector3<f64>) -> f64 {
        (position - self.origin).dot(&self.plane_normal)
    }

    /// Place of the surface at a point of the plane and a height over it, m.
    pub(crate) fn place_over(&self, in_plane: &Vector2<f64>, height_m: f64) -> Vector3<f64> {
        self.origin
            + self.x_axis * in_plane.x
            + self.y_axis * in_plane.y
            + self.plane_normal * height_m
    }

    /// A direction in axes of the plane, in base axes.
    pub(crate) fn in_base(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.x_axis * v.x + self.y_axis * v.y + self.plane_normal * v.z
    }

    /// Slope of a surface with this normal over the plane, m per m; zero for a path whose points
    /// are lengths along the surface.
    pub(crate) fn slope(&self, normal: &Vector3<f64>) -> Vector2<f64> {
        if !self.over_plane {
            return Vector2::zeros();
        }
        -self.flat(normal) / normal.dot(&self.plane_normal).max(COSINE_MIN)
    }

    /// Whether the path over the plane cannot be followed on a surface with this normal, which
    /// faces away from the plane.
    pub(crate) fn faces_away(&self, normal: &Vector3<f64>) -> bool {
        self.over_plane && normal.dot(&self.plane_normal) < 0.0
    }

    /// Length along the surface per length of the path in a direction of the plane.
    fn stretch(&self, along: &Vector2<f64>, normal: &Vector3<f64>) -> f64 {
        let length = along.norm();
        if !self.over_plane || length < 1e-12 {
            return 1.0;
        }
        self.on_surface(*along, normal).norm() / length
    }

    /// A displacement along the surface (m, axes of the path's plane) as it is drawn in the plane.
    pub(crate) fn drawn(&self, on_surface: Vector2<f64>, normal: &Vector3<f64>) -> Vector2<f64> {
        on_surface / self.stretch(&on_surface, normal)
    }

    /// Vector from a tool at `position` to the reference, in the tangent plane, m.
    fn error(&self, path: &Path, position: &Vector3<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
        if !self.over_plane {
            return tangential(&(self.reference - position), normal);
        }
        let wanted = path.at(self.clock_s).position + self.aside;
        self.on_surface(wanted - self.flat(&(position - self.origin)), normal)
    }

    /// Stops the clock at once, after a loss of contact.
    pub fn freeze(&mut self) {
        self.clock_rate = 0.0;
    }

    /// Slows the clock to a share of its speed at once: something stands in the way.
    pub fn brake(&mut self, share: f64) {
        self.clock_rate = self.clock_rate.min(share);
    }

    /// Whether the clock stands.
    pub fn stands(&self) -> bool {
        self.clock_rate <= 0.0
    }

    /// Processes one cycle. Returns the desired velocity in the tangent plane of `normal`, base
    /// axes, m/s. `speed_factor` is 1 at the path's own speed and 0 to stand.
    pub fn step(
        &mut self,
        config: &PathConfig,
        path: &Path,
        speed_factor: f64,
        position: &Vector3<f64>,
        normal: &Vector3<f64>,
        dt_s: f64,
    ) -> Vector3<f64> {
        // The reference is projected into the tangent plane through the tool: the normal direction
        // is force-controlled.
        let error = self.error(path, position, normal);
        let waiting = (2.0 - error.norm() / config.wait_error_m).clamp(0.0, 1.0);
        self.waiting = waiting <= 0.0 && speed_factor > 0.0;
        let step = dt_s / config.clock_ramp_s;
        self.clock_rate += (speed_factor - self.clock_rate).clamp(-step, step);
        let now = path.at(self.clock_s);
        let before = now.position;
        let rate = self.clock_rate * waiting / self.stretch(&now.velocity, normal);
        self.clock_s = (self.clock_s + rate * dt_s).min(path.slides_until_s(self.lifts_done));
        self.moved_by(
            config,
            path.at(self.clock_s).position - before,
            position,
            error,
            normal,
            dt_s,
        )
    }

    /// Like [`Tracking::step`], with the path's clock standing and the reference displaced by
    /// `on_surface` (m along the surface, axes of the path's plane).
    pub fn step_aside(
        &mut self,
        config: &PathConfig,
        path: &Path,
        on_surface: Vector2<f64>,
        position: &Vector3<f64>,
        normal: &Vector3<f64>,
        dt_s: f64,
    ) -> Vector3<f64> {
        self.clock_rate = 0.0;
        let error = self.error(path, position, normal);
        let in_plane = self.drawn(on_surface, normal);
        self.aside += in_plane;
        self.moved_by(config, in_plane, position, error, normal, dt_s)
    }

    /// Own speed of the path at its clock, m/s: the highest one in the time that the clock takes to
    /// stop.
    pub fn speed_m_per_s(&self, config: &PathConfig, path: &Path) -> f64 {
        let until_s = path.slides_until_s(self.lifts_done);
        let after = |ahead_s: f64| {
            path.at((self.clock_s + ahead_s).min(until_s))
                .velocity
                .norm()
        };
        after(0.0).max(after(config.clock_ramp_s))
    }

    /// Direction of the path at its clock, in the tangent plane of `normal`, unit, base axes;
    /// `None` where it stands.
    pub fn direction(&self, path: &Path, normal: &Vector3<f64>) -> Option<Vector3<f64>> {
        let ahead = path
            .at((self.clock_s + AHEAD_S).min(path.slides_until_s(self.lifts_done)))
            .position;
        self.on_surface(ahead - path.at(self.clock_s).position, normal)
            .try_normalize(1e-9)
    }

    fn moved_by(
        &mut self,
        config: &PathConfig,
        in_plane: Vector2<f64>,
        position: &Vector3<f64>,
        error: Vector3<f64>,
        normal: &Vector3<f64>,
        dt_s: f64,
    ) -> Vector3<f64> {
        let way = self.on_surface(in_plane, normal);
        self.reference = position + error + way;
        way / dt_s + clamp_norm(error * config.gain_per_s, config.feedback_speed_max_m_per_s)
    }

    /// Brings a vector of the plane into the tangent plane of `normal`; base axes.
    pub(crate) fn on_surface(&self, in_plane: Vector2<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
        let flat = self.x_axis * in_plane.x + self.y_axis * in_plane.y;
        if self.over_plane {
            return flat + self.plane_normal * self.slope(normal).dot(&in_plane);
        }
        match UnitQuaternion::rotation_between(&self.plane_normal, normal) {
            Some(rotation) => rotation * flat,
            // Opposite normals: no unique smallest rotation. Stand still.
            None => Vector3::zeros(),
        }
    }

    /// Index of the stroke at the path's clock, and the distance along it, m; `None` before the
    /// first one.
    pub fn place(&self, path: &Path) -> Option<(usize, f64)> {
        path.stroke_at(self.clock_s)
    }

    /// Elapsed share of the path's time, 0 to 1.
    pub fn progress(&self, path: &Path) -> f64 {
        if path.duration_s() > 0.0 {
            (self.clock_s / path.duration_s()).min(1.0)
        } else {
            1.0
        }
    }

    /// Whether the path stands because the tool is far from its reference.
    pub fn waits(&self) -> bool {
        self.waiting
    }

    /// Whether the path is at its end.
    pub fn is_finished(&self, path: &Path) -> bool {
        self.clock_s >= path.duration_s()
    }

    /// Distance of `position` from the reference in the tangent plane of `normal`, m.
    pub fn error_m(&self, position: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
        tangential(&(self.reference - position), normal).norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::path::PathSpec;

    fn circle(radius: f64) -> Path {
        let spec: PathSpec = toml::from_str(&format!(
            "kind = \"circle\"\nradius_m = {radius}\nspeed_m_per_s = 0.02"
        ))
        .unwrap();
        Path::new(&spec, 0.1, 1.0).unwrap()
    }

    #[test]
    fn no_path_over_a_plane_goes_on_along_a_surface_that_faces_away_from_it() {
        let tracking = Tracking::new(Vector3::z(), Vector3::x(), Vector3::zeros());
        let tracking = tracking.drawn_over_plane(true);
        let turned = |deg: f64| {
            let (sin, cos) = deg.to_radians().sin_cos();
            Vector3::new(sin, 0.0, cos)
        };
        assert!(!tracking.faces_away(&turned(80.0)));
        assert!(tracking.faces_away(&turned(100.0)));
    }

    /// On a cylinder (flat when unrolled) a circle closes, and keeps its drawn length.
    #[test]
    fn a_circle_on_a_pipe_closes() {
        let (config, path, dt) = (PathConfig::default(), circle(0.08), 0.008);
        let radius = 0.25;
        let mut tracking =
            Tracking::new(Vector3::z(), Vector3::x(), Vector3::new(0.0, 0.0, radius));
        let mut position = Vector3::new(0.0, 0.0, radius);
        let (mut length, mut steepest) = (0.0, 0.0f64);
        while !tracking.is_finished(&path) {
            let normal = Vector3::new(0.0, position.y, position.z).normalize();
            let v = tracking.step(&config, &path, 1.0, &position, &normal, dt);
            assert!(v.dot(&normal).abs() < 1e-12);
            position += v * dt;
            let outward = Vector3::new(0.0, position.y, position.z).normalize() * radius;
            position = Vector3::new(position.x, outward.y, outward.z);
            length += v.norm() * dt;
            steepest = steepest.max(normal.y.abs().asin());
        }
        assert!(steepest > 0.25, "{steepest}");
        assert!(
            (position - Vector3::new(0.0, 0.0, radius)).norm() < 1e-3,
            "{position}"
        );
        assert!(
            (length - std::f64::consts::TAU * 0.08).abs() < 2e-3,
            "{length}"
        );
    }

    #[test]
    fn stops_where_it_is_and_goes_on_there() {
        let (config, path, dt) = (PathConfig::default(), circle(0.05), 0.008);
        let mut tracking = Tracking::new(Vector3::z(), Vector3::x(), Vector3::zeros());
        let mut position = Vector3::zeros();
        let mut run = |factor: f64, cycles: usize, freeze: bool| {
            for _ in 0..cycles {
                if freeze {
                    tracking.freeze();
                }
                position +=
                    tracking.step(&config, &path, factor, &position, &Vector3::z(), dt) * dt;
            }
            (tracking.progress(&path), position)
        };
        run(1.0, 500, false);
        run(0.0, 100, false);
        let stopped = run(0.0, 1, false);
        let later = run(0.0, 200, false);
        assert_eq!(stopped.0, later.0);
        assert!((stopped.1 - later.1).norm() < 1e-6);
        let frozen = run(1.0, 0, false);
        assert_eq!(frozen.0, later.0);
        assert!(run(1.0, 100, false).0 > later.0);
    }

    #[test]
    fn waits_for_an_arm_that_does_not_follow() {
        let (config, path) = (PathConfig::default(), circle(0.05));
        let mut tracking = Tracking::new(Vector3::z(), Vector3::x(), Vector3::zeros());
        for _ in 0..5000 {
            tracking.step(&config, &path, 1.0, &Vector3::zeros(), &Vector3::z(), 0.008);
        }
        assert!(!tracking.is_finished(&path));
        assert!(tracking.reference.norm() <= 2.0 * config.wait_error_m + 1e-6);
    }

    #[test]
    fn the_x_axis_is_laid_into_the_plane() {
        let tracking = Tracking::new(Vector3::x(), Vector3::x(), Vector3::zeros());
        assert!(tracking.x_axis.dot(&Vector3::x()).abs() < 1e-12);
        assert!((tracking.x_axis.norm() - 1.0).abs() < 1e-12);
    }
}
