//! The path that a specification draws.
//!
//! Called while a task is loaded; allocates.

use nalgebra::Vector2;

use super::Path;
use super::lift::Rise;
use super::shape::Shape;
use super::spec::{PathSpec, Raster};
use super::stroke_way::StrokeWay;
use super::strokes::Strokes;
use crate::error::ControlError;
use crate::task::profile::Profile;
use crate::task::region::Region;

impl Path {
    /// Gives the path its time law.
    pub fn new(
        spec: &PathSpec,
        acceleration_m_per_s2: f64,
        jerk_m_per_s3: f64,
    ) -> Result<Self, ControlError> {
        spec.check()?;
        let mut path = Self::empty(Rise::default());
        let bounds = (acceleration_m_per_s2, jerk_m_per_s3);
        match spec {
            PathSpec::Raster(r) => path.raster(r, bounds),
            PathSpec::Circle(c) => {
                // The centripetal acceleration is v²/r, its jerk v³/r².
                let speed = c
                    .speed_m_per_s
                    .min((acceleration_m_per_s2 * c.radius_m).sqrt())
                    .min((jerk_m_per_s3 * c.radius_m * c.radius_m).cbrt());
                let length = std::f64::consts::TAU * c.radius_m * c.turns.abs();
                path.push(
                    Shape::Arc {
                        centre: Vector2::new(c.radius_m, 0.0),
                        radius: c.radius_m,
                        start_rad: std::f64::consts::PI,
                        sign: c.turns.signum(),
                    },
                    Profile::new(length, speed, bounds.0, bounds.1),
                );
            }
            PathSpec::Line(l) => {
                let ends = [Vector2::zeros(), Vector2::from(l.to_m)];
                for i in 0..l.strokes as usize {
                    if i > 0 {
                        path.duration_s += l.pause_s;
                    }
                    path.straight(ends[i % 2], ends[(i + 1) % 2], l.speed_m_per_s, bounds);
                }
            }
            PathSpec::Waypoints(w) => {
                let mut from = Vector2::zeros();
                for point in &w.points_m {
                    let to = Vector2::from(*point);
                    path.straight(from, to, w.speed_m_per_s, bounds);
                    path.duration_s += w.pause_s;
                    from = to;
                }
            }
            PathSpec::Loops(l) => {
                // The policy's time accelerates to its rate and decelerates again within the
                // acceleration limit.
                let speed = l.speed();
                path.push(
                    Shape::Loops {
                        radius: l.radius_m,
                        turn_rate: l.turn_rate_rad_per_s,
                        advance: l.advance_m_per_s,
                    },
                    Profile::new(l.duration_s, 1.0, bounds.0 / speed, bounds.1 / speed),
                );
            }
            PathSpec::Stay(s) => path.duration_s = s.duration_s,
            PathSpec::Strokes(s) => path.strokes(s, bounds),
            PathSpec::Region(r) => path.region(r, bounds)?,
        }
        Ok(path)
    }

    fn raster(&mut self, r: &Raster, bounds: (f64, f64)) {
        let mut corners = vec![Vector2::zeros()];
        for line in 0..r.lines {
            let y = r.step_m * f64::from(line);
            let (near, far) = (Vector2::new(0.0, y), Vector2::new(r.length_m, y));
            let (from, to) = if line % 2 == 0 {
                (near, far)
            } else {
                (far, near)
            };
            if line > 0 {
                corners.push(from);
            }
            corners.push(to);
        }
        loop {
            for ends in corners.windows(2) {
                if r.duration_s > 0.0 && self.duration_s >= r.duration_s {
                    self.duration_s = r.duration_s;
                    return;
                }
                self.straight(ends[0], ends[1], r.speed_m_per_s, bounds);
                self.duration_s += r.pause_s;
            }
            if self.duration_s >= r.duration_s {
                break;
            }
            corners.reverse();
        }
        if r.duration_s > 0.0 {
            self.duration_s = r.duration_s;
        }
    }

    fn strokes(&mut self, spec: &Strokes, bounds: (f64, f64)) {
        self.rise = Rise {
            lift_m: spec.lift_m,
            speed_m_per_s: spec.travel_speed_m_per_s,
        };
        let mut from = Vector2::zeros();
        for stroke in &spec.strokes {
            let points: Vec<_> = stroke.points_m.iter().map(|p| Vector2::from(*p)).collect();
            let way = StrokeWay {
                points: &points,
                lifts: Strokes::lifts(&from, &points[0]),
                force_n: stroke.force_n,
                profile: &stroke.force_profile,
                speed_m_per_s: stroke.speed_m_per_s.unwrap_or(spec.speed_m_per_s),
                pause_s: spec.pause_s,
            };
            from = self.stroke(from, &way, bounds);
        }
    }

    fn region(&mut self, region: &Region, bounds: (f64, f64)) -> Result<(), ControlError> {
        self.rise = Rise {
            lift_m: region.lift_m,
            speed_m_per_s: region.travel_speed_m_per_s,
        };
        let mut from = Vector2::zeros();
        for stroke in region.plan()? {
            let way = StrokeWay {
                points: &stroke.points,
                lifts: stroke.lifts,
                force_n: None,
                profile: &[],
                speed_m_per_s: region.speed_m_per_s,
                pause_s: region.pause_s,
            };
            from = self.stroke(from, &way, bounds);
        }
        Ok(())
    }
}
