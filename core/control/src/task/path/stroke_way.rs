//! Strokes of a path, and the ways above the surface between them.
//!
//! Before a lift, the path's clock stops until the tool has landed at the start of the next stroke.
//! Called while a task is loaded, and where a path is filled again while it runs: that does not
//! allocate within the room that was reserved.

use nalgebra::Vector2;

use super::lift::{Lift, Rise};
use super::shape::Shape;
use super::turns::{TURN_MAX_RAD, turn_rad, turn_speed_m_per_s};
use super::{Path, Pressing};
use crate::task::profile::Profile;

/// Points of a stroke that are nearer than this are one point, m.
const SAME_M: f64 = 1e-6;

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
        let mut path = Self::empty(rise);
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
