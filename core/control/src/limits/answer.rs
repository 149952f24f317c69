//! Whether the mean of the pressing force follows the tool's depth: detects a dead sensor that
//! still produces noise.
//!
//! Called by `response_guard` in each cycle in which the tool presses. Noise is averaged out, and
//! the depth is delayed like the force, so that both refer to the same time. Whenever the mean has
//! moved, depth and distance are counted from zero again: a sensor whose reading moves is alive.
//!
//! While the tool slides, an error of the normal turns distance along the surface into apparent
//! depth. A depth within the slope that this error can make is not judged: a surface that recedes
//! at constant force cannot be distinguished from a dead sensor.

/// Time constant over which force and depth are averaged, s.
const MEAN_S: f64 = 0.04;
/// Delay of a reading relative to the tool's motion, s: filter, cycle, servo.
const LAG_S: f64 = 0.02;
/// Time constant of the noise estimate, s.
const NOISE_S: f64 = 0.3;
/// Number of standard errors by which the mean must change to count as moved, and which an expected
/// but missing rise must exceed.
const MOVED_ERRORS: f64 = 6.0;
const RISE_ERRORS: f64 = 8.0;
/// Minimum change of the mean that counts, N, and as a share of the reference.
const MOVED_N: f64 = 0.1;
const MOVED_SHARE: f64 = 0.03;
/// Minimum expected rise before its absence is judged, N, and as a share of the reference.
const RISE_N: f64 = 1.5;
const RISE_SHARE: f64 = 0.1;
/// Additional indentation before judging, m: for a pad that settles, and for the delay, which is
/// not known to the millisecond.
const RISE_M: f64 = 6e-5;
/// Share of the expected rise below which the mean did not follow.
const FOLLOWED: f64 = 0.2;
/// Softest contact assumed until the stiffness is measured, N/m, and the number of times that it
/// must have moved the mean by the threshold before its absence is judged. Up to a force of
/// [`FIRST_N`], N, a soft tip is softer than it becomes.
const SOFTEST_N_PER_M: f64 = 500.0;
const SOFTEST_AT_FIRST_N_PER_M: f64 = 200.0;
const FIRST_N: f64 = 0.6;
/// Share of these stiffnesses that a soft tip has: one that lands tilted touches with its rim.
const SOFT_TIP_SHARE: f64 = 0.5;
const MOVED_TIMES: f64 = 2.0;
/// Depth that is not known when a stiffness is measured, m: delay, and a pad that settles.
const SHOWN_M: f64 = 3e-5;
/// Maximum depth since the mean last moved, whatever the stiffness, m.
const BEYOND_M: f64 = 3e-3;

/// How the mean of the reading must follow the tool's depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DepthRule {
    /// Whether the tool stands while the force builds up: depth and force then show the stiffness.
    pub settling: bool,
    /// Slope by which the normal in use may be wrong.
    pub slope: f64,
    /// Speed along the normal that an edge of the tip has while the tool turns about its origin,
    /// m/s: the contact may be at that edge.
    pub edge_speed_m_per_s: f64,
    /// Depth without a change of the force that the cell allows, m.
    pub blind_max_m: f64,
    /// Whether the tip is stated as soft.
    pub soft_tip: bool,
}

/// Measurements of one cycle in which the tool presses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pressed {
    /// Motion since the last cycle, m: into the surface along the normal in use, and across it.
    pub deeper_m: f64,
    pub across_m: f64,
    /// Distance that an edge of the tip may have moved along the normal because the tool turned, m.
    pub edge_m: f64,
    /// Force along the normal in use, N.
    pub force_n: f64,
    /// Reference force, N.
    pub reference_n: f64,
    pub rule: DepthRule,
    /// Period, s.
    pub dt_s: f64,
}

/// Depth, distance and mean force at one time.
#[derive(Clone, Copy, Debug)]
struct Mark {
    depth_m: f64,
    across_m: f64,
    edge_m: f64,
    force_n: f64,
}

/// State for one contact. A new one is the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answer {
    depth_m: f64,
    /// Depth with the delay of the reading and of its mean, m.
    late_m: f64,
    now: Mark,
    /// State when the mean last moved.
    moved: Mark,
    /// State at touchdown, while the force builds up.
    touched: Option<Mark>,
    /// Previous reading, N, and the variance of its noise, N².
    last_n: f64,
    variance: f64,
    /// Measured stiffness of the contact, N/m.
    stiffness_n_per_m: Option<f64>,
}

impl Answer {
    /// Starts at a touch; `stiffness_n_per_m` is the stiffness measured in an earlier touch, N/m.
    pub fn new(pressed: &Pressed, stiffness_n_per_m: Option<f64>) -> Self {
        let mark = Mark {
            depth_m: 0.0,
            across_m: 0.0,
            edge_m: 0.0,
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

    /// Lower bound of the measured contact stiffness, N/m.
    pub fn stiffness_n_per_m(&self) -> Option<f64> {
        self.stiffness_n_per_m
    }

    /// Standard error of the mean of the pressing force, N, at this period.
    pub fn error_n(&self, dt_s: f64) -> f64 {
        (self.variance * dt_s / (2.0 * MEAN_S)).sqrt()
    }

    /// Counts depth and mean from here: another observation has shown that the reading is alive.
    pub fn accept(&mut self) {
        self.moved = self.now;
    }

    /// Processes one cycle; returns whether the mean should have followed and did not.
    pub fn is_missing(&mut self, pressed: &Pressed) -> bool {
        self.average(pressed);
        let error_n = self.error_n(pressed.dt_s);
        self.learn(pressed, error_n);
        let followed_n = self.now.force_n - self.moved.force_n;
        let least_n = MOVED_N.max(MOVED_SHARE * pressed.reference_n);
        let moved_n = least_n.max(MOVED_ERRORS * error_n);
        if followed_n.abs() >= moved_n {
            self.moved = self.now;
            return false;
        }
        let across_m = self.now.across_m - self.moved.across_m;
        let edge_m = self.now.edge_m - self.moved.edge_m;
        let depth_m =
            self.now.depth_m - self.moved.depth_m - pressed.rule.slope * across_m - edge_m;
        // The softest contact would have moved the mean by now, whatever the noise.
        let softest_n_per_m = if self.now.force_n < FIRST_N {
            SOFTEST_AT_FIRST_N_PER_M
        } else {
            SOFTEST_N_PER_M
        };
        let tip_share = if pressed.rule.soft_tip {
            SOFT_TIP_SHARE
        } else {
            1.0
        };
        let telling_m = RISE_M + MOVED_TIMES * moved_n / (tip_share * softest_n_per_m);
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
        now.edge_m += pressed.edge_m;
        now.force_n += (pressed.force_n - now.force_n) * share(MEAN_S);
        let change = pressed.force_n - self.last_n;
        self.last_n = pressed.force_n;
        self.variance += (0.5 * change * change - self.variance) * share(NOISE_S);
    }

    /// Keeps the highest stiffness shown while the force builds up: a reading that stops following
    /// does not make the contact softer. What noise and the delay may contribute is taken off, so
    /// that a contact is not taken for a stiffer one.
    fn learn(&mut self, pressed: &Pressed, error_n: f64) {
        if !pressed.rule.settling {
            self.touched = None;
        }
        let Some(touched) = &self.touched else {
            return;
        };
        let risen_n = self.now.force_n - touched.force_n - MOVED_ERRORS * error_n;
        if risen_n > (3.0 * MOVED_N).max(0.1 * pressed.reference_n) {
            let shown = risen_n / ((self.now.depth_m - touched.depth_m).abs() + SHOWN_M);
            let before = self.stiffness_n_per_m.unwrap_or(0.0);
            self.stiffness_n_per_m = Some(before.max(shown));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulates at 1 kHz a tool that goes deeper at `speed`, m/s; returns the true rise of the
    /// force, N, when the fault is detected, or `None` after 20 s.
    fn missed_n(
        stiffness: f64,
        known: bool,
        speed: f64,
        read: impl Fn(f64, usize) -> f64,
    ) -> Option<f64> {
        missed_with_n(false, stiffness, known, speed, read)
    }

    fn missed_with_n(
        soft_tip: bool,
        stiffness: f64,
        known: bool,
        speed: f64,
        read: impl Fn(f64, usize) -> f64,
    ) -> Option<f64> {
        let mut pressed = Pressed {
            deeper_m: 0.0,
            across_m: 0.0,
            edge_m: 0.0,
            force_n: read(0.0, 0),
            reference_n: 10.0,
            rule: DepthRule {
                settling: false,
                slope: 0.1,
                edge_speed_m_per_s: 0.0,
                blind_max_m: 0.03,
                soft_tip,
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
        // Without a measured stiffness the depth limit applies.
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

    /// A swab that lands tilted touches with its rim: 200 N/m, where a hard tip has at least 500.
    #[test]
    fn the_rim_of_a_soft_tip_answers_little_and_a_dead_sensor_is_still_found() {
        let missed_m = |soft_tip, read: &dyn Fn(f64, usize) -> f64| {
            // On 1 N/m, newtons are metres.
            missed_with_n(soft_tip, 1.0, false, 0.003, read)
        };
        let rim = |depth: f64, k| 1.0 + 200.0 * depth + 0.3 * noise_n(k);
        let dead = |_, k| 1.0 + 0.3 * noise_n(k);
        assert_eq!(missed_m(true, &rim), None);
        assert!(missed_m(false, &rim).is_some());
        for soft_tip in [false, true] {
            let found_m = missed_m(soft_tip, &dead).unwrap();
            assert!(found_m < 3.2e-3, "{soft_tip}: {found_m}");
        }
    }

    #[test]
    fn a_slope_at_constant_force_is_no_missing_answer() {
        let mut pressed = Pressed {
            deeper_m: 9e-6,
            across_m: 1e-4,
            edge_m: 0.0,
            force_n: 10.0,
            reference_n: 10.0,
            rule: DepthRule {
                settling: false,
                slope: 0.1,
                edge_speed_m_per_s: 0.0,
                blind_max_m: 0.03,
                soft_tip: false,
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
            edge_m: 0.0,
            force_n: 1.0,
            reference_n: 10.0,
            rule: DepthRule {
                settling: true,
                slope: 0.1,
                edge_speed_m_per_s: 0.0,
                blind_max_m: 0.03,
                soft_tip: false,
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
