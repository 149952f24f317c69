//! Delay of the loop from a velocity command to the measured force, measured in free space from the
//! law's own commands and the arm's joint positions.
//!
//! Called by the controller each cycle. While the tool moves freely, a joint that follows the
//! velocity `v` through any delay and lag of unit gain, `T` in all, is behind the integral of its
//! commands by `T v` once it moves steadily. A change of the velocity between two steady windows
//! therefore gives `T = Δlag · Δv / (Δv · Δv)` over all joints, however the change itself went.

use tangent_mechanics::Joints;

/// Settings of the measurement: constant while the arm moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopDelay {
    /// Time after a change of the command until the arm counts as steady, s: longer than any
    /// plausible delay.
    pub settle_s: f64,
    /// Duration of a steady window, s.
    pub window_s: f64,
    /// Smallest change of the joints' velocity that is measured, rad/s.
    pub change_min_rad_per_s: f64,
    /// Change of the command that ends a window, as a share of the velocity.
    pub steady_share: f64,
    /// Error of the mean joint position of a window, rad: resolution of the encoders, which a mean
    /// at rest does not reduce.
    pub position_sd_rad: f64,
    /// Largest difference between the arm's speed and the commanded speed in a window, as a share.
    pub gain_error_max: f64,
    /// Plausible delays from command to measured force, s.
    pub plausible_s: (f64, f64),
}

impl Default for LoopDelay {
    fn default() -> Self {
        Self {
            settle_s: 0.25,
            window_s: 0.1,
            change_min_rad_per_s: 5e-4,
            steady_share: 0.03,
            position_sd_rad: 4e-6,
            gain_error_max: 0.2,
            plausible_s: (0.004, 0.15),
        }
    }
}

/// Inputs of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct DelaySample<const N: usize> {
    /// Measured joint positions of this cycle, rad.
    pub q: Joints<N>,
    /// Joint velocities commanded in this cycle, rad/s.
    pub commanded: Joints<N>,
    /// Delay of the measured wrench: its filter's, and its age, s.
    pub sensing_s: f64,
    /// Whether the tool moves in free space and the arm carries out the commands unscaled.
    pub free: bool,
    /// Period, s.
    pub dt_s: f64,
}

/// Mean of a steady window.
#[derive(Clone, Copy, Debug)]
struct Window<const N: usize> {
    velocity: Joints<N>,
    lag: Joints<N>,
    /// Variance of the mean lag, all joints, rad².
    variance_rad2: f64,
    /// Change of the lag from the first to the second half of the window, rad.
    drift: Joints<N>,
}

/// Sums over a window that has not ended.
#[derive(Clone, Copy, Debug)]
struct Sums<const N: usize> {
    count: f64,
    velocity: Joints<N>,
    lag: Joints<N>,
    square_rad2: f64,
    halves: [(f64, Joints<N>); 2],
}

impl<const N: usize> Sums<N> {
    fn new() -> Self {
        Self {
            count: 0.0,
            velocity: Joints::zeros(),
            lag: Joints::zeros(),
            square_rad2: 0.0,
            halves: [(0.0, Joints::zeros()); 2],
        }
    }

    fn add(&mut self, velocity: &Joints<N>, lag: &Joints<N>, second_half: bool) {
        self.count += 1.0;
        self.velocity += (velocity - self.velocity) / self.count;
        let from_old = lag - self.lag;
        self.lag += from_old / self.count;
        self.square_rad2 += from_old.dot(&(lag - self.lag));
        let (count, mean) = &mut self.halves[usize::from(second_half)];
        *count += 1.0;
        *mean += (lag - *mean) / *count;
    }

    fn mean(&self) -> Window<N> {
        Window {
            velocity: self.velocity,
            lag: self.lag,
            // Successive positions are not independent: a quarter of them counts.
            variance_rad2: 4.0 * self.square_rad2 / (self.count * self.count),
            drift: self.halves[1].1 - self.halves[0].1,
        }
    }
}

/// State of the measurement. It outlives a task: the arm stays the same.
#[derive(Clone, Copy, Debug)]
pub struct LoopDelayState<const N: usize> {
    /// Integral of the commands since the tool became free, rad; starts at the measured position.
    commanded_rad: Option<Joints<N>>,
    level: Joints<N>,
    level_s: f64,
    sums: Sums<N>,
    /// The last steady window, and the time since it ended, s.
    window: Option<(Window<N>, f64)>,
    /// Whether the command has changed since that window.
    changed: bool,
    information_per_s2: f64,
    motion_s: f64,
    sensing_s: f64,
    half_period_s: f64,
}

impl<const N: usize> Default for LoopDelayState<N> {
    fn default() -> Self {
        Self {
            commanded_rad: None,
            level: Joints::zeros(),
            level_s: 0.0,
            sums: Sums::new(),
            window: None,
            changed: false,
            information_per_s2: 0.0,
            motion_s: 0.0,
            sensing_s: 0.0,
            half_period_s: 0.0,
        }
    }
}

/// Age at which the window before a change is too old: a small error of the arm's speed would
/// have added up.
const WINDOW_AGE_MAX_S: f64 = 1.0;
/// Standard deviation of the combined measurement is not taken to be smaller than this share of the
/// delay: the next tasks' measurements count, in case the delay changes.
const INFORMATION_SHARE: f64 = 0.03;

impl LoopDelay {
    /// Processes one cycle. Allocates nothing.
    pub fn step<const N: usize>(&self, state: &mut LoopDelayState<N>, sample: &DelaySample<N>) {
        let dt = sample.dt_s;
        if !sample.free {
            return state.interrupt();
        }
        let commanded = match state.commanded_rad {
            Some(commanded) => commanded,
            None => {
                state.begin_level(&sample.commanded);
                sample.q
            }
        };
        let lag = commanded - sample.q;
        state.commanded_rad = Some(commanded + sample.commanded * dt);
        state.half_period_s = 0.5 * dt;
        if let Some((_, age_s)) = &mut state.window {
            *age_s += dt;
        }
        let change = (sample.commanded - state.level).norm();
        if change > (self.steady_share * state.level.norm()).max(0.5 * self.change_min_rad_per_s) {
            state.begin_level(&sample.commanded);
            state.changed = true;
            return;
        }
        state.level_s += dt;
        let into_window_s = state.level_s - self.settle_s;
        if into_window_s <= 0.0 {
            return;
        }
        state
            .sums
            .add(&sample.commanded, &lag, into_window_s > 0.5 * self.window_s);
        if into_window_s + 0.5 * dt < self.window_s {
            return;
        }
        let window = state.sums.mean();
        let before = state.window.replace((window, 0.0));
        if let (Some((before, age_s)), true) = (before, state.changed)
            && age_s < WINDOW_AGE_MAX_S
            && let Some((motion_s, variance_s2)) = self.delay_between(&before, &window)
        {
            state.combine(motion_s, variance_s2);
            state.sensing_s = sample.sensing_s;
        }
        state.changed = false;
        // The next window follows without a pause.
        state.level_s = self.settle_s;
        state.sums = Sums::new();
    }

    /// Delay from command to motion that two steady windows show, s, and its variance, s²; `None`
    /// if the change is too small or the arm did not follow.
    fn delay_between<const N: usize>(
        &self,
        before: &Window<N>,
        after: &Window<N>,
    ) -> Option<(f64, f64)> {
        let change = after.velocity - before.velocity;
        let square = change.norm_squared();
        if square.sqrt() < self.change_min_rad_per_s {
            return None;
        }
        let floor = self.position_sd_rad * self.position_sd_rad;
        let variance = before.variance_rad2 + after.variance_rad2 + 2.0 * floor;
        let deviation = (variance / square).sqrt();
        // Half a window lies between the two halves. The noise of their difference is allowed for.
        let gain_error = after.drift.dot(&change) / square / (0.5 * self.window_s);
        let allowed = self.gain_error_max + 4.0 * deviation / (0.5 * self.window_s);
        let delay_s = (after.lag - before.lag).dot(&change) / square;
        let plausible = (0.0..=self.plausible_s.1).contains(&delay_s);
        (gain_error.abs() < allowed && plausible).then_some((delay_s, deviation * deviation))
    }

    /// Measured delay from command to measured force, s, and its standard deviation, s; `None`
    /// without a measurement.
    pub fn measured_s<const N: usize>(&self, state: &LoopDelayState<N>) -> Option<(f64, f64)> {
        let deviation_s =
            (state.information_per_s2 > 0.0).then(|| state.information_per_s2.sqrt().recip())?;
        // A command is held for a period: half of it is delay.
        let delay_s = state.motion_s + state.sensing_s + state.half_period_s;
        Some((
            delay_s.clamp(self.plausible_s.0, self.plausible_s.1),
            deviation_s,
        ))
    }

    /// Delay to use and its uncertainty, s: the mean of the measurement and of the `setting` (delay
    /// and standard deviation, s), each weighted by its certainty. The uncertainty reaches up to
    /// the setting at least: a measurement that is too short costs no stability. Without a
    /// measurement, the setting alone.
    pub fn in_use_s<const N: usize>(
        &self,
        state: &LoopDelayState<N>,
        setting: (f64, f64),
    ) -> (f64, f64) {
        let (setting_s, setting_sd_s) = setting;
        match self.measured_s(state) {
            Some((delay_s, deviation_s)) if setting_sd_s > 0.0 => {
                let (stated, shown) = (setting_sd_s.powi(-2), deviation_s.powi(-2));
                let sum = stated + shown;
                let mean_s = (setting_s * stated + delay_s * shown) / sum;
                let deviation_s = sum.sqrt().recip().max(setting_s - mean_s);
                (mean_s, deviation_s)
            }
            _ => (setting_s, 0.0),
        }
    }
}

impl<const N: usize> LoopDelayState<N> {
    /// Ends the present window without a measurement: the commands are no longer those of this law,
    /// or the tool is not free.
    pub fn interrupt(&mut self) {
        self.commanded_rad = None;
        self.window = None;
        self.changed = false;
    }

    fn begin_level(&mut self, velocity: &Joints<N>) {
        self.level = *velocity;
        self.level_s = 0.0;
        self.sums = Sums::new();
    }

    /// Weighted mean of all measurements.
    fn combine(&mut self, motion_s: f64, variance_s2: f64) {
        let new = variance_s2.recip();
        let sum = self.information_per_s2 + new;
        self.motion_s += (motion_s - self.motion_s) * new / sum;
        let smallest_s = (INFORMATION_SHARE * self.motion_s).max(1e-4);
        self.information_per_s2 = sum.min((smallest_s * smallest_s).recip());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;

    /// One arm: transport delay and a second-order lag per joint, encoders with a resolution.
    struct Joint6 {
        line: VecDeque<Joints<6>>,
        natural_rad_per_s: f64,
        q: Joints<6>,
        qd: Joints<6>,
        qdd: Joints<6>,
        resolution_rad: f64,
    }

    impl Joint6 {
        fn new(cycles: usize, hz: f64) -> Self {
            Self {
                line: VecDeque::from(vec![Joints::zeros(); cycles]),
                natural_rad_per_s: std::f64::consts::TAU * hz,
                q: Joints::<6>::repeat(0.3),
                qd: Joints::zeros(),
                qdd: Joints::zeros(),
                resolution_rad: 1e-5,
            }
        }

        fn step(&mut self, command: Joints<6>, dt: f64) {
            self.line.push_back(command);
            let wanted = self.line.pop_front().unwrap();
            let (w, h) = (self.natural_rad_per_s, dt / 64.0);
            for _ in 0..64 {
                self.qdd = (self.qdd + (wanted - self.qd) * (w * w * h))
                    / (1.0 + 1.6 * w * h + w * w * h * h);
                self.qd += self.qdd * h;
                self.q += self.qd * h;
            }
        }

        fn measured(&self, noise: f64) -> Joints<6> {
            self.q
                .map(|x| (x / self.resolution_rad).round() * self.resolution_rad + noise)
        }
    }

    /// Rest, then an approach of `speed` rad/s in two joints, on a ramp. Returns the measured delay
    /// and its deviation.
    fn approach(
        cycles: usize,
        hz: f64,
        dt: f64,
        speed: f64,
        seconds: f64,
        noise: f64,
    ) -> Option<(f64, f64)> {
        let law = LoopDelay::default();
        let (mut state, mut arm) = (LoopDelayState::default(), Joint6::new(cycles, hz));
        let mut along = Joints::<6>::zeros();
        along[1] = 0.6;
        along[2] = -0.8;
        let mut command = 0.0f64;
        for i in 0..((0.6 + seconds) / dt) as u32 {
            let wanted = if f64::from(i) * dt < 0.6 { 0.0 } else { speed };
            command += (wanted - command).clamp(-2.0 * dt, 2.0 * dt);
            let sign = f64::from(i * 7919 % 101) / 50.0 - 1.0;
            law.step(
                &mut state,
                &DelaySample {
                    q: arm.measured(noise * sign),
                    commanded: along * command,
                    sensing_s: 0.0075,
                    free: true,
                    dt_s: dt,
                },
            );
            arm.step(along * command, dt);
        }
        law.measured_s(&state)
    }

    fn truth(cycles: usize, hz: f64, dt: f64) -> f64 {
        cycles as f64 * dt + 1.6 / (std::f64::consts::TAU * hz) + 0.0075 + 0.5 * dt
    }

    #[test]
    fn an_approach_shows_the_delay_of_slow_and_fast_arms() {
        for dt in [0.008, 0.002] {
            for cycles in [1, 2, 3, 6] {
                for hz in [10.0, 15.0, 25.0] {
                    for speed in [0.003, 0.01] {
                        let (delay, deviation) = approach(cycles, hz, dt, speed, 0.5, 0.0).unwrap();
                        let expected = truth(cycles, hz, dt);
                        assert!(
                            (delay - expected).abs() < 3.0 * deviation + 1e-4 && deviation < 3e-3,
                            "{delay} ± {deviation}, not {expected} s"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn an_approach_too_short_or_too_slow_leaves_the_setting() {
        assert_eq!(approach(2, 15.0, 0.008, 0.005, 0.2, 0.0), None);
        assert_eq!(approach(2, 15.0, 0.008, 2e-4, 1.0, 0.0), None);
        // Positions that are uncertain by 0.1 mrad say so.
        let (_, deviation) = approach(2, 15.0, 0.008, 0.002, 0.5, 1e-4).unwrap();
        assert!(deviation > 0.005, "{deviation}");
    }

    #[test]
    fn an_arm_that_does_not_follow_teaches_nothing() {
        let law = LoopDelay::default();
        let mut state = LoopDelayState::default();
        for i in 0..200 {
            let commanded = Joints::<6>::repeat(if i < 80 { 0.0 } else { 0.01 });
            law.step(
                &mut state,
                &DelaySample {
                    q: Joints::zeros(),
                    commanded,
                    sensing_s: 0.0,
                    free: true,
                    dt_s: 0.008,
                },
            );
        }
        assert_eq!(law.measured_s(&state), None);
        assert_eq!(law.in_use_s(&state, (0.04, 0.02)), (0.04, 0.0));
    }

    proptest! {
        /// Whatever is measured and commanded, the delay in use is plausible or the setting.
        #[test]
        fn the_delay_in_use_stays_plausible(values in prop::collection::vec((-1.0f64..1.0, -1.0f64..1.0, prop::bool::weighted(0.95)), 1..400)) {
            let law = LoopDelay::default();
            let mut state = LoopDelayState::<6>::default();
            for (q, commanded, free) in values {
                let sample = DelaySample {
                    q: Joints::repeat(q),
                    commanded: Joints::repeat(commanded.round() * 0.01),
                    sensing_s: 0.0075,
                    free,
                    dt_s: 0.008,
                };
                law.step(&mut state, &sample);
                let (delay, deviation) = law.in_use_s(&state, (0.04, 0.04));
                prop_assert!((0.004..=0.15).contains(&delay), "{delay}");
                prop_assert!((0.0..=0.04).contains(&deviation), "{deviation}");
                prop_assert_eq!(law.in_use_s(&state, (0.04, 0.0)), (0.04, 0.0));
            }
        }
    }
}
