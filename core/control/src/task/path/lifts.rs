//! Strokes of a path, and the ways above the surface between them.
//!
//! Before a lift, the path's clock stops until the tool has landed at the start of the next stroke.
//! Called while a task is loaded, and where a path is filled again while it runs: that does not
//! allocate within the room that was reserved.

use nalgebra::Vector2;

use super::chain::{TURN_MAX_RAD, turn_rad, turn_speed_m_per_s};
use super::force_profile::{force_at, steepest_n_per_m};
use super::ranges::{default_lift, default_travel};
use super::strokes::Strokes;
use super::{Path, Pressing, Shape, Stretch};
use crate::error::ControlError;
use crate::task::profile::Profile;
use crate::task::region::Region;

/// Points of a stroke that are nearer than this are one point, m.
const SAME_M: f64 = 1e-6;

/// A way above the surface, in plane coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lift {
    /// Time of the path at which the tool leaves the surface, s.
    pub start_s: f64,
    /// Time of the path at which it is back, s.
    pub end_s: f64,
    /// Where it leaves, m.
    pub from: Vector2<f64>,
    /// Where it lands, m.
    pub to: Vector2<f64>,
}

/// How the tool moves above the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rise {
    /// Height above the surface, m.
    pub lift_m: f64,
    /// Speed, m/s.
    pub speed_m_per_s: f64,
}

impl Default for Rise {
    fn default() -> Self {
        Self {
            lift_m: default_lift(),
            speed_m_per_s: default_travel(),
        }
    }
}

/// A stroke of a path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StrokeWay<'a> {
    /// Points, m; one or more.
    pub points: &'a [Vector2<f64>],
    /// Whether the tool lifts off on the way to the first point.
    pub lifts: bool,
    /// Pressing force, N; `None`: the task's.
    pub force_n: Option<f64>,
    /// Force along the stroke, m and N; empty: `force_n`.
    pub profile: &'a [[f64; 2]],
    pub speed_m_per_s: f64,
    /// Pause at sharp corners and at the end, s.
    pub pause_s: f64,
}

impl Path {
    /// Number of times that the tool lifts off the surface.
    pub fn lifts(&self) -> usize {
        self.lifts.len()
    }

    /// Whether strokes have forces of their own.
    pub fn has_forces(&self) -> bool {
        self.stretches
            .iter()
            .any(|stretch| stretch.pressing != Pressing::OfTask)
    }

    /// The lift after `done` others.
    pub(crate) fn lift(&self, done: usize) -> Option<&Lift> {
        self.lifts.get(done)
    }

    /// Time up to which the tool slides after `done` lifts, s.
    pub(crate) fn slides_until_s(&self, done: usize) -> f64 {
        self.lifts
            .get(done)
            .map_or(self.duration_s, |lift| lift.start_s)
    }

    pub(crate) fn rise(&self) -> Rise {
        self.rise
    }

    /// Pressing force at `time_s`, N: of its stroke, or of a profile there. `None`: the task's.
    pub(crate) fn force_n(&self, time_s: f64) -> Option<f64> {
        let index = (self.stretches).partition_point(|stretch| stretch.start_s <= time_s);
        let stretch = self.stretches.get(index.checked_sub(1)?)?;
        match stretch.pressing {
            Pressing::OfTask => None,
            Pressing::Constant(force_n) => Some(force_n),
            Pressing::Profile {
                first,
                count,
                offset_m,
            } => {
                let (distance, _) = stretch.profile.at(time_s - stretch.start_s);
                let way_m = offset_m + distance * stretch.shape.metres_per_unit();
                force_at(&self.profiles[first..first + count], way_m)
            }
        }
    }

    /// Gives the whole path a force that varies along it. `profile` counts the ways on the surface,
    /// without those above it.
    pub(crate) fn press_along(&mut self, profile: &[[f64; 2]]) {
        let first = self.profiles.len();
        self.profiles.extend_from_slice(profile);
        let lifts = &self.lifts;
        let above = |stretch: &Stretch| {
            let after = lifts.partition_point(|lift| lift.start_s <= stretch.start_s);
            let lift = after.checked_sub(1).and_then(|k| lifts.get(k));
            lift.is_some_and(|lift| stretch.start_s < lift.end_s)
        };
        let mut offset_m = 0.0;
        for stretch in &mut self.stretches {
            stretch.pressing = Pressing::Profile {
                first,
                count: profile.len(),
                offset_m,
            };
            if !above(stretch) {
                offset_m += stretch.length_m();
            }
        }
    }

    /// Fastest change of a force profile at the speed of the path, N/s.
    pub(crate) fn force_rate_max_n_per_s(&self) -> f64 {
        let rate = |stretch: &Stretch| match stretch.pressing {
            Pressing::OfTask | Pressing::Constant(_) => 0.0,
            Pressing::Profile { first, count, .. } => {
                let profile = &self.profiles[first..first + count];
                let speed = stretch.profile.speed_max() * stretch.shape.metres_per_unit();
                steepest_n_per_m(profile) * speed
            }
        };
        self.stretches.iter().map(rate).fold(0.0, f64::max)
    }

    /// Highest pressing force of a stroke, N; `None` if no stroke has its own.
    pub fn force_max_n(&self) -> Option<f64> {
        let constant = self.stretches.iter().filter_map(|s| match s.pressing {
            Pressing::Constant(force_n) => Some(force_n),
            Pressing::OfTask | Pressing::Profile { .. } => None,
        });
        let along = self.profiles.iter().map(|[_, force_n]| *force_n);
        constant.chain(along).max_by(f64::total_cmp)
    }

    pub(super) fn strokes(&mut self, spec: &Strokes, bounds: (f64, f64)) {
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

    pub(super) fn region(
        &mut self,
        region: &Region,
        bounds: (f64, f64),
    ) -> Result<(), ControlError> {
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

    /// Adds a stroke, and the way to it from `from`. Returns its end.
    pub(crate) fn stroke(
        &mut self,
        from: Vector2<f64>,
        way: &StrokeWay<'_>,
        bounds: (f64, f64),
    ) -> Vector2<f64> {
        let first = way.points[0];
        if way.lifts {
            let start_s = self.duration_s;
            self.straight(from, first, self.rise.speed_m_per_s, bounds);
            self.lifts.push(Lift {
                start_s,
                end_s: self.duration_s,
                from,
                to: first,
            });
        } else {
            let before = self.stretches.len();
            self.straight(from, first, way.speed_m_per_s, bounds);
            self.press_with(before, way.force_n);
        }
        let place = self.profiles.len();
        self.profiles.extend_from_slice(way.profile);
        let mut way_m = 0.0;
        // Chains end at sharp corners.
        let mut begin = 0;
        while begin + 1 < way.points.len() {
            let mut end = begin + 1;
            while end + 1 < way.points.len() {
                let [a, b, c] = [way.points[end - 1], way.points[end], way.points[end + 1]];
                if turn_rad(&a, &b, &c) > TURN_MAX_RAD {
                    break;
                }
                end += 1;
            }
            let before = self.stretches.len();
            self.chain(&way.points[begin..=end], way.speed_m_per_s, bounds);
            self.press_with(before, way.force_n);
            for stretch in &mut self.stretches[before..] {
                if !way.profile.is_empty() {
                    stretch.pressing = Pressing::Profile {
                        first: place,
                        count: way.profile.len(),
                        offset_m: way_m,
                    };
                }
                way_m += stretch.length_m();
            }
            self.duration_s += way.pause_s;
            begin = end;
        }
        way.points.last().copied().unwrap_or(first)
    }

    /// Sets the force of the stretches from the index `first`.
    fn press_with(&mut self, first: usize, force_n: Option<f64>) {
        for stretch in &mut self.stretches[first..] {
            stretch.pressing = force_n.map_or(Pressing::OfTask, Pressing::Constant);
        }
    }

    /// Adds lines that are passed without a stop.
    fn chain(&mut self, line: &[Vector2<f64>], speed_m_per_s: f64, bounds: (f64, f64)) {
        if let [from, to] = line {
            return self.straight(*from, *to, speed_m_per_s, bounds);
        }
        let first = self.points.len();
        let (mut way_m, mut speed) = (0.0, speed_m_per_s);
        self.points.push((line[0], 0.0));
        for (k, point) in line.iter().enumerate().skip(1) {
            let step_m = (point - self.points[self.points.len() - 1].0).norm();
            if step_m < SAME_M {
                continue;
            }
            way_m += step_m;
            self.points.push((*point, way_m));
            if let Some(next) = line.get(k + 1) {
                let turn = turn_rad(&line[k - 1], point, next);
                speed = speed.min(turn_speed_m_per_s(turn, bounds.0));
            }
        }
        let count = self.points.len() - first;
        if count < 2 {
            return self.points.truncate(first);
        }
        let profile = Profile::new(way_m, speed, bounds.0, bounds.1);
        self.push(Shape::Chain { first, count }, profile);
    }

    /// A path for `strokes` strokes of straight lines, which are added while the task runs.
    pub(crate) fn with_room(strokes: usize, rise: Rise) -> Self {
        let mut path = Self {
            stretches: Vec::new(),
            points: Vec::new(),
            lifts: Vec::new(),
            profiles: Vec::new(),
            rise,
            duration_s: 0.0,
        };
        path.reserve(strokes);
        path
    }

    /// Makes room for `strokes` strokes of straight lines: for each, a way to it and itself.
    /// Allocates.
    pub(crate) fn reserve(&mut self, strokes: usize) {
        let room = |want: usize, have: usize| want.saturating_sub(have);
        self.stretches
            .reserve_exact(room(2 * strokes, self.stretches.len()));
        self.lifts.reserve_exact(room(strokes, self.lifts.len()));
    }

    /// Removes all strokes and keeps the room.
    pub(crate) fn clear(&mut self) {
        self.stretches.clear();
        self.points.clear();
        self.lifts.clear();
        self.profiles.clear();
        self.duration_s = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::super::PathSpec;
    use super::*;

    fn path(toml: &str) -> Path {
        let spec: PathSpec = toml::from_str(toml).unwrap();
        spec.check().unwrap();
        Path::new(&spec, 0.1, 1.0).unwrap()
    }

    const TWO: &str = "kind = \"strokes\"
        speed_m_per_s = 0.02
        [[strokes]]
        points_m = [[0.0, 0.0], [0.05, 0.0]]
        [[strokes]]
        points_m = [[0.05, 0.02], [0.0, 0.02]]
        force_n = 6.0
        speed_m_per_s = 0.04
        [[strokes]]
        points_m = [[0.0, 0.02], [0.0, 0.04]]";

    #[test]
    fn strokes_have_lifts_forces_and_speeds() {
        let path = path(TWO);
        // The last stroke goes on where the second one ends.
        assert_eq!(path.lifts(), 1);
        let lift = *path.lift(0).unwrap();
        assert_eq!((lift.from.x, lift.to.y), (0.05, 0.02));
        assert_eq!(path.at(lift.end_s).position, lift.to);
        assert_eq!(path.slides_until_s(0), lift.start_s);
        assert_eq!(path.slides_until_s(1), path.duration_s());
        assert_eq!(path.force_n(0.5 * lift.start_s), None);
        assert_eq!(path.force_n(lift.end_s), Some(6.0));
        assert_eq!(path.force_n(path.duration_s()), None);
        assert_eq!(path.force_max_n(), Some(6.0));
        let fastest = |from: f64, to: f64| {
            (0..1000)
                .map(|k| {
                    path.at(from + (to - from) * f64::from(k) / 1000.0)
                        .velocity
                        .norm()
                })
                .fold(0.0, f64::max)
        };
        assert!((fastest(0.0, lift.start_s) - 0.02).abs() < 1e-6);
        assert!((fastest(lift.end_s, lift.end_s + 1.0) - 0.04).abs() < 1e-6);
    }

    #[test]
    fn bad_strokes_are_refused_by_their_number() {
        for (from, to, words) in [
            (
                "force_n = 6.0",
                "force_n = 600.0",
                ["path.strokes[1].force_n", "0.5 to 100"],
            ),
            (
                "0.02], [0.0, 0.02",
                "nan], [0.0, 0.02",
                ["path.strokes[1].points_m", "-2 to 2"],
            ),
            (
                "[[0.0, 0.0], [0.05, 0.0]]",
                "[]",
                ["path.strokes[0].points_m", "1 point"],
            ),
        ] {
            let spec: PathSpec = toml::from_str(&TWO.replace(from, to)).unwrap();
            let error = spec.check().unwrap_err().to_string();
            assert!(words.iter().all(|word| error.contains(word)), "{error}");
        }
    }

    #[test]
    fn a_line_of_many_small_turns_is_passed_without_a_stop() {
        let ring = |k: i32| {
            let angle = f64::from(k) * 0.05;
            format!("[{}, {}]", 0.05 * angle.sin(), 0.05 * (1.0 - angle.cos()))
        };
        let points: Vec<String> = (0..=60).map(ring).collect();
        let path = path(&format!(
            "kind = \"strokes\"\nspeed_m_per_s = 0.03\n[[strokes]]\npoints_m = [{}]",
            points.join(", ")
        ));
        assert_eq!((path.lifts(), path.stretches.len()), (0, 1));
        let mut t = 0.6;
        while t < path.duration_s() - 0.6 {
            let speed = path.at(t).velocity.norm();
            assert!((speed - 0.03).abs() < 1e-9, "{t}: {speed}");
            t += 0.01;
        }
        assert!((path.duration_s() - (0.15 / 0.03 + 0.45)).abs() < 0.05);
    }
}
