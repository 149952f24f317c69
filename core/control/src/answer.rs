//! Whether the mean of the pressing force goes with the tool's depth: what a sensor that no longer
//! feels and still makes noise gives away.
//!
//! Called by `response_guard` in each cycle in which the tool presses. Noise is averaged away, and
//! the depth is delayed as the force is, so that both are of one time. Whenever the mean has moved,
//! depth and way count anew: a sensor whose reading moves, answers.
//!
//! While the tool slides, a normal that is off makes a depth of the way along the surface. So that
//! much of the way counts as slope, and what sinks less steeply is not judged: a surface that
//! recedes at constant force cannot be told from a sensor that is deaf.

/// Time constant over which force and depth are averaged, s.
const MEAN_S: f64 = 0.04;
/// Delay of a reading behind the tool, s: filter, cycle, servo.
const LAG_S: f64 = 0.02;
/// Memory of the noise's own size, s.
const NOISE_S: f64 = 0.3;
/// Standard errors by which the mean has to move to have moved, and the rise that it fails to make
/// has to exceed.
const MOVED_ERRORS: f64 = 6.0;
const RISE_ERRORS: f64 = 8.0;
/// Least movement that counts, N, and as a share of the reference.
const MOVED_N: f64 = 0.1;
const MOVED_SHARE: f64 = 0.03;
/// Rise that must have come before its absence says anything, N, and as a share of the reference.
const RISE_N: f64 = 1.5;
const RISE_SHARE: f64 = 0.1;
/// And as much as this way into the contact makes, m: a pad that settles, and the delay that is not
/// known to the millisecond.
const RISE_M: f64 = 6e-5;
/// Share of the rise below which the mean did not follow.
const FOLLOWED: f64 = 0.2;
/// Softest contact reckoned with until it has shown its own stiffness, N/m: its mean would have
/// moved this many times over.
const SOFTEST_N_PER_M: f64 = 500.0;
const MOVED_TIMES: f64 = 2.0;
/// Least depth that a stiffness is taken from, m.
const SHOWN_M: f64 = 3e-5;
/// Depth that may be gone, whatever the stiffness, since the mean moved last, m.
const BEYOND_M: f64 = 3e-3;

/// What a reading's mean has to make of the tool's depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DepthRule {
    /// The tool stands and the force builds up: depth and force show the stiffness.
    pub settling: bool,
    /// Slope that the normal in use may be off by.
    pub slope: f64,
    /// Depth without an answer that the cell allows, m.
    pub blind_max_m: f64,
}

/// One cycle of a tool that presses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pressed {
    /// Into the surface since the cycle before, along the normal in use, and across it, m.
    pub deeper_m: f64,
    pub across_m: f64,
    /// Along the normal in use, N.
    pub force_n: f64,
    /// Asked for, N.
    pub reference_n: f64,
    pub rule: DepthRule,
    /// s
    pub dt_s: f64,
}

/// Depth, way and mean force at one time.
#[derive(Clone, Copy, Debug)]
struct Mark {
    depth_m: f64,
    across_m: f64,
    force_n: f64,
}

/// Memory of one contact. A new one is the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answer {
    depth_m: f64,
    /// The depth as late as the reading, and as its mean, m.
    late_m: f64,
    now: Mark,
    /// Where the mean moved last.
    moved: Mark,
    /// Where the tool touched, while the force builds up.
    touched: Option<Mark>,
    /// The reading before, N, and the variance of its noise, N².
    last_n: f64,
    variance: f64,
    /// Shown by the contact, N/m.
    stiffness_n_per_m: Option<f64>,
}

impl Answer {
    /// The tool touches; `stiffness_n_per_m` is what an earlier touch has shown.
    pub fn new(pressed: &Pressed, stiffness_n_per_m: Option<f64>) -> Self {
        let mark = Mark {
            depth_m: 0.0,
            across_m: 0.0,
            force_n: pressed.force_n,
        };
        Self {
            depth_m: 0.0,
            late_m: 0.0,
            now: mark,
            moved: mark,
            touched: pressed.rule.settling.then_some(mark),
            last_n: pressed.force_n,
            variance: 0.0,
            stiffness_n_per_m,
        }
    }

    /// Least stiffness that the contact has shown, N/m.
    pub fn stiffness_n_per_m(&self) -> Option<f64> {
        self.stiffness_n_per_m
    }

    /// One cycle: whether the mean should have followed and did not.
    pub fn is_missing(&mut self, pressed: &Pressed) -> bool {
        self.average(pressed);
        self.learn(pressed);
        let error_n = (self.variance * pressed.dt_s / (2.0 * MEAN_S)).sqrt();
        let followed_n = self.now.force_n - self.moved.force_n;
        let least_n = MOVED_N.max(MOVED_SHARE * pressed.reference_n);
        let moved_n = least_n.max(MOVED_ERRORS * error_n);
        if followed_n.abs() >= moved_n {
            self.moved = self.now;
            return false;
        }
        let across_m = self.now.across_m - self.moved.across_m;
        let depth_m = self.now.depth_m - self.moved.depth_m - pressed.rule.slope * across_m;
        // The softest contact would have moved the mean by now, whatever its noise.
        let telling_m = RISE_M + MOVED_TIMES * moved_n / SOFTEST_N_PER_M;
        if depth_m > telling_m.max(BEYOND_M).min(pressed.rule.blind_max_m) {
            return true;
        }
        let Some(stiffness) = self.stiffness_n_per_m else {
            return depth_m > telling_m;
        };
        let due_n = stiffness * depth_m;
        let enough_n = RISE_N.max(RISE_SHARE * pressed.reference_n) + RISE_M * stiffness;
        due_n >= enough_n.max(RISE_ERRORS * error_n) && followed_n < FOLLOWED * due_n
    }

    fn average(&mut self, pressed: &Pressed) {
        let share = |time_s: f64| pressed.dt_s / (pressed.dt_s + time_s);
        self.depth_m += pressed.deeper_m;
        self.late_m += (self.depth_m - self.late_m) * share(LAG_S);
        let now = &mut self.now;
        now.depth_m += (self.late_m - now.depth_m) * share(MEAN_S);
        now.across_m += pressed.across_m;
        now.force_n += (pressed.force_n - now.force_n) * share(MEAN_S);
        let change = pressed.force_n - self.last_n;
        self.last_n = pressed.force_n;
        self.variance += (0.5 * change * change - self.variance) * share(NOISE_S);
    }

    /// The stiffest that the build-up of the force has shown: a reading that stops to follow does
    /// not make the contact softer.
    fn learn(&mut self, pressed: &Pressed) {
        if !pressed.rule.settling {
            self.touched = None;
        }
        let Some(touched) = &self.touched else {
            return;
        };
        let risen_n = self.now.force_n - touched.force_n;
        if risen_n > (3.0 * MOVED_N).max(0.1 * pressed.reference_n) {
            let shown = risen_n / (self.now.depth_m - touched.depth_m).max(SHOWN_M);
            let before = self.stiffness_n_per_m.unwrap_or(0.0);
            self.stiffness_n_per_m = Some(before.max(shown));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A kilohertz of a tool that goes `speed` (m/s) deeper; the true rise of the force, N, when
    /// the answer is missed, or none in 20 s.
    fn missed_n(
        stiffness: f64,
        known: bool,
        speed: f64,
        read: impl Fn(f64, usize) -> f64,
    ) -> Option<f64> {
        let mut pressed = Pressed {
            deeper_m: 0.0,
            across_m: 0.0,
            force_n: read(0.0, 0),
            reference_n: 10.0,
            rule: DepthRule {
                settling: false,
                slope: 0.1,
                blind_max_m: 0.03,
            },
            dt_s: 1e-3,
        };
        let mut answer = Answer::new(&pressed, known.then_some(stiffness));
        (1..20_000).find_map(|k| {
            let depth_m = speed * 1e-3 * k as f64;
            pressed.deeper_m = speed * 1e-3;
            pressed.force_n = read(depth_m, k);
            answer.is_missing(&pressed).then_some(stiffness * depth_m)
        })
    }

    fn noise_n(k: usize) -> f64 {
        0.1 * ((k * 7919 % 1000) as f64 / 500.0 - 1.0)
    }

    #[test]
    fn noise_over_a_level_that_stands_is_no_answer() {
        for stiffness in [1e3, 5e3, 1e4, 5e4] {
            let speed = 20.0 / stiffness;
            let deaf = missed_n(stiffness, true, speed, |_, k| 10.0 + noise_n(k));
            assert!(deaf.is_some_and(|n| n < 8.0), "{stiffness}: {deaf:?}");
        }
        // What no contact has shown is bounded by the depth.
        let deaf = missed_n(500.0, false, 0.01, |_, k| 10.0 + noise_n(k));
        assert!(deaf.is_some_and(|n| n < 500.0 * 4.5e-3), "{deaf:?}");
    }

    #[test]
    fn a_reading_that_follows_is_an_answer() {
        for stiffness in [500.0, 1e3, 5e3, 5e4] {
            for known in [true, false] {
                let speed = 20.0 / stiffness;
                let read = |depth: f64, k| 2.0 + stiffness * depth + noise_n(k);
                assert_eq!(missed_n(stiffness, known, speed, read), None);
            }
        }
    }

    #[test]
    fn a_slope_at_constant_force_is_no_missing_answer() {
        let mut pressed = Pressed {
            deeper_m: 9e-6,
            across_m: 1e-4,
            force_n: 10.0,
            reference_n: 10.0,
            rule: DepthRule {
                settling: false,
                slope: 0.1,
                blind_max_m: 0.03,
            },
            dt_s: 1e-3,
        };
        let mut answer = Answer::new(&pressed, Some(5e4));
        for k in 0..20_000 {
            pressed.force_n = 10.0 + noise_n(k);
            assert!(!answer.is_missing(&pressed));
        }
    }

    #[test]
    fn the_stiffness_is_shown_while_the_force_builds_up_and_stays() {
        let mut pressed = Pressed {
            deeper_m: 5e-7,
            across_m: 0.0,
            force_n: 1.0,
            reference_n: 10.0,
            rule: DepthRule {
                settling: true,
                slope: 0.1,
                blind_max_m: 0.03,
            },
            dt_s: 1e-3,
        };
        let mut answer = Answer::new(&pressed, None);
        for k in 1..2000 {
            pressed.force_n = 1.0 + (5e3 * 5e-7 * f64::from(k)).min(3.0);
            if answer.is_missing(&pressed) {
                let shown = answer.stiffness_n_per_m().unwrap();
                assert!((4e3..6e3).contains(&shown), "{shown}");
                return;
            }
        }
        panic!("not missed");
    }
}
