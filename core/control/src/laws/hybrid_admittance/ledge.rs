//! Steps over what stands in the way: a ledge that the tool cannot climb while it presses.
//!
//! `side_load` stops the path and gives way. Where that lasts, the tool lifts off, passes over a
//! stretch of the path, and lands behind it. What is missed shows in the coverage. A tool that is
//! stopped again and again without getting on ends the task.
//!
//! Called by the phase machine in the phase `slide`.

/// Time for which the tool gives way before it lifts off, s.
const STOOD_S: f64 = 1.0;
/// Time of the path by which the tool has to get on between two stops, s.
const GOT_ON_S: f64 = 0.5;
/// Stops in sequence after which the path is blocked.
const STOPS_MAX: u32 = 3;

/// What the tool does about something in the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// Goes on, or waits.
    On,
    /// Lifts off and passes over it.
    Over,
    /// Cannot pass.
    Blocked,
}

/// State for one run. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Ledge {
    stood_s: f64,
    stops: u32,
    /// The path's clock after the last stop, s.
    went_on_s: f64,
}

impl Ledge {
    /// Processes one cycle of the sliding tool; `clock_s` is the path's clock.
    pub fn step(&mut self, gives_way: bool, clock_s: f64, dt_s: f64) -> Way {
        // A load that comes and goes is one stop.
        let change_s = if gives_way { dt_s } else { -dt_s };
        self.stood_s = (self.stood_s + change_s).max(0.0);
        if self.stood_s < STOOD_S {
            return Way::On;
        }
        self.stood_s = 0.0;
        let got_on = clock_s > self.went_on_s + GOT_ON_S;
        self.stops = if got_on { 1 } else { self.stops + 1 };
        if self.stops > STOPS_MAX {
            return Way::Blocked;
        }
        Way::Over
    }

    /// The tool goes on behind the obstacle, with the path's clock at `clock_s`.
    pub fn passed(&mut self, clock_s: f64) {
        self.went_on_s = clock_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ways in sequence of a tool that is always stopped and gets on by `got_on_s` each time.
    fn ways(got_on_s: f64) -> Vec<Way> {
        let (mut ledge, mut clock_s) = (Ledge::default(), 5.0);
        let mut ways = Vec::new();
        for _ in 0..6 {
            let next = (0..2000).find_map(|_| {
                let way = ledge.step(true, clock_s, 0.002);
                (way != Way::On).then_some(way)
            });
            ways.extend(next);
            ledge.passed(clock_s);
            clock_s += got_on_s;
        }
        ways
    }

    #[test]
    fn ledges_are_passed_one_after_the_other_but_a_wall_blocks() {
        assert_eq!(ways(2.0), [Way::Over; 6]);
        let wall = ways(0.1);
        assert_eq!(wall[..3], [Way::Over; 3]);
        assert_eq!(wall[3], Way::Blocked);
    }

    #[test]
    fn a_short_push_is_no_reason_to_lift_off() {
        let mut ledge = Ledge::default();
        for k in 0..5000 {
            let pushed = k % 500 < 200;
            assert_eq!(ledge.step(pushed, 1.0, 0.002), Way::On);
        }
    }
}
