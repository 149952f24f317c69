//! Where a path goes on past something in its way.

use super::Path;

/// Longest step of the search, s: a path that stands may go on at any time.
const STEP_MAX_S: f64 = 0.1;
/// Share of the length by which the place is sought.
const STEP_SHARE: f64 = 0.05;
/// Halvings of a step that has passed the place.
const BISECTIONS: u32 = 20;
/// Distance to a turn of the path behind which there is room for the tool, m, and the way back
/// after which it is a turn.
const PAST_LEAST_M: f64 = 0.005;
const BACK_M: f64 = 0.0005;
/// Most steps of the search, which is done within one cycle: a minute of a path that hardly moves.
const STEPS_MAX: u32 = 600;
/// Rest of a path that is worth staying for, s.
const STAYS_S: f64 = 1.0;

impl Path {
    /// Time after `from_s`, s, at which the path is `length_m` away from where it is then, or the
    /// time of the first turn that is at least `PAST_LEAST_M` away. A path that ends before that,
    /// at `end_s`, goes on at its end, and one that stays there for longer goes on from `from_s`. A
    /// path that is too slow to get so far within [`STEPS_MAX`] goes on at the place that is
    /// furthest away until then. Allocates nothing.
    pub(crate) fn ahead_s(&self, from_s: f64, end_s: f64, length_m: f64) -> f64 {
        let here = self.at(from_s).position;
        let away_m = |time_s: f64| (self.at(time_s).position - here).norm();
        let (mut turn_s, mut turn_m) = (from_s, 0.0);
        let mut time_s = from_s;
        for _ in 0..STEPS_MAX {
            if time_s >= end_s {
                break;
            }
            // As far as a path at this speed takes for a part of the length.
            let speed = self.at(time_s).velocity.norm();
            let step_s = (STEP_SHARE * length_m / speed.max(f64::MIN_POSITIVE)).min(STEP_MAX_S);
            let before_s = time_s;
            time_s = (time_s + step_s).min(end_s);
            let m = away_m(time_s);
            if m >= length_m {
                return first_time(before_s, time_s, |time_s| away_m(time_s) >= length_m);
            }
            if m > turn_m {
                (turn_s, turn_m) = (time_s, m);
            } else if turn_m > PAST_LEAST_M && m < turn_m - BACK_M {
                return turn_s;
            }
        }
        let stays = turn_m < PAST_LEAST_M && end_s > from_s + STAYS_S;
        if stays {
            from_s
        } else if time_s < end_s {
            turn_s
        } else {
            end_s
        }
    }
}

/// First time between these, s, at which something holds that does not at the first, and does at
/// the last.
fn first_time(mut near_s: f64, mut far_s: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..BISECTIONS {
        let middle_s = 0.5 * (near_s + far_s);
        if holds(middle_s) {
            far_s = middle_s;
        } else {
            near_s = middle_s;
        }
    }
    far_s
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;

    fn path(spec: &str) -> Path {
        Path::new(&toml::from_str(spec).unwrap(), 0.1, 1.0).unwrap()
    }

    /// Places at `from_s` and where a tool goes on that steps over 30 mm of a line there.
    fn steps_over(strokes: u32, from_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let path = path(&format!(
            "kind = \"line\"\nto_m = [0.04, 0.0]\nspeed_m_per_s = 0.02\nstrokes = {strokes}"
        ));
        let past_s = path.ahead_s(from_s, path.duration_s(), 0.03);
        assert!(past_s - from_s < 5.0, "{past_s}");
        (path.at(from_s).position, path.at(past_s).position)
    }

    #[test]
    fn steps_over_a_length_of_the_path_or_to_its_next_turn() {
        // Near the start of a stroke.
        let (from, to) = steps_over(20, 0.5);
        assert!(((to - from).norm() - 0.03).abs() < 1e-6, "{from} {to}");
        // In its middle, the other end is nearer: the strokes after it are not passed over.
        let (from, to) = steps_over(20, 1.2);
        assert!(from.x > 0.015 && (to.x - 0.04).abs() < 1e-3, "{from} {to}");
        // Close to the end of a stroke, it goes on behind the turn.
        let (from, to) = steps_over(20, 2.1);
        assert!(from.x > 0.036 && to.x < 0.011, "{from} {to}");
        // The last stroke ends there.
        let (_, to) = steps_over(1, 2.1);
        assert!((to.x - 0.04).abs() < 1e-9, "{to}");
    }

    #[test]
    fn a_tool_that_presses_in_one_place_does_not_step_to_the_end() {
        let path = path("kind = \"stay\"\nduration_s = 60.0");
        assert_eq!(path.ahead_s(10.0, path.duration_s(), 0.03), 10.0);
    }

    #[test]
    fn a_slow_path_is_searched_for_a_minute() {
        let path = path("kind = \"line\"\nto_m = [0.4, 0.0]\nspeed_m_per_s = 0.001");
        let to_s = path.ahead_s(100.0, path.duration_s(), 0.2);
        assert!((to_s - 160.0).abs() < 0.2, "{to_s}");
        assert!(path.at(to_s).position.x > path.at(100.0).position.x + PAST_LEAST_M);
    }
}
