//! Contact stiffness from touchdown: measured force per distance that the arm itself moves.
//!
//! Called by the controller while the tool stands on the surface and the force builds up. While the
//! tool slides, the depth also changes with the surface's shape, so nothing is learnt.
//!
//! Depth and force both have errors, and on a stiff contact the depth's are larger than the depth
//! itself: a regression of force on depth would find a stiff contact soft. The slope is therefore
//! Deming's (W. E. Deming, Statistical Adjustment of Data, 1943), which weighs both.

/// Deming regression of force on depth with forgetting.
#[derive(Clone, Copy, Debug)]
pub struct Stiffness {
    value_n_per_m: f64,
    known: bool,
    settled: bool,
    depth_lagged_m: Option<f64>,
    weight: f64,
    depth_mean: f64,
    force_mean: f64,
    depth_var: f64,
    force_var: f64,
    covariance: f64,
    since: Option<Since>,
}

/// Depth and force since the touch.
#[derive(Clone, Copy, Debug)]
struct Since {
    depth_m: f64,
    force_n: f64,
    /// Mean of the force over the last [`MEAN_S`], N.
    mean_n: f64,
}

impl Since {
    /// Largest stiffness, N/m, that a contact can have whose force has risen so little over this
    /// depth; infinite while the depth shows nothing.
    fn most_n_per_m(&self, depth_m: f64) -> f64 {
        let way_m = depth_m - self.depth_m - WAY_SDS * DEPTH_SD_M;
        let risen_n = (self.mean_n - self.force_n).max(0.0) + UNFELT_N;
        if way_m > 0.0 {
            MOST_FACTOR * risen_n / way_m
        } else {
            f64::INFINITY
        }
    }
}

/// Minimum spread of depth for a measurement, m: well above a joint encoder's noise at the tool.
const SPREAD_MIN_M: f64 = 1.5e-5;
/// Softest and stiffest plausible contact, N/m.
const BELIEVED: (f64, f64) = (300.0, 120_000.0);
/// Standard deviations of the errors of depth, m, and of force, N: gear ripple, joint speed noise,
/// vibration.
pub(super) const DEPTH_SD_M: f64 = 2e-5;
const FORCE_SD_N: f64 = 0.08;
/// Smallest squared correlation of depth and force that shows a stiffness.
const CORRELATION_MIN: f64 = 0.3;
/// Time constant with which a lower stiffness is adopted, s.
const LOWER_S: f64 = 0.06;
/// Share of the stiffness in use from which a measurement is near it.
const SETTLED_SHARE: f64 = 0.8;
/// A contact that gives way without a force is soft: standard deviations of the depth that do not
/// count, force that may stay unfelt, N, time over which the force is averaged, s, and the factor
/// by which a contact may be stiffer than it seems. The softest that is concluded from it, N/m:
/// the tool may not touch yet.
const WAY_SDS: f64 = 3.0;
const UNFELT_N: f64 = 0.3;
const MEAN_S: f64 = 0.1;
const MOST_FACTOR: f64 = 2.0;
const MOST_LEAST_N_PER_M: f64 = 5000.0;
/// Time constant of the forgetting, s.
pub(super) const MEMORY_S: f64 = 1.5;

impl Stiffness {
    /// Nothing learnt yet: `expected_n_per_m` is used until there is a measurement.
    pub fn new(expected_n_per_m: f64) -> Self {
        Self {
            value_n_per_m: expected_n_per_m,
            known: false,
            settled: false,
            depth_lagged_m: None,
            weight: 0.0,
            depth_mean: 0.0,
            force_mean: 0.0,
            depth_var: 0.0,
            force_var: 0.0,
            covariance: 0.0,
            since: None,
        }
    }

    /// Stiffness in use, N/m.
    pub fn value_n_per_m(&self) -> f64 {
        self.value_n_per_m
    }

    /// Whether the stiffness was measured, rather than expected.
    pub fn is_known(&self) -> bool {
        self.known
    }

    /// Whether the stiffness in use has come down to the one measured in this contact.
    pub fn is_settled(&self) -> bool {
        self.settled
    }

    /// Processes one cycle: `depth_m` grows into the surface; `force_n` lags it by `delay_s`, the
    /// delay of the wrench filter. The stiffness in use is not lowered below `least_n_per_m`.
    pub fn update(
        &mut self,
        depth_m: f64,
        force_n: f64,
        least_n_per_m: f64,
        delay_s: f64,
        dt_s: f64,
    ) {
        let lagged = self.depth_lagged_m.map_or(depth_m, |lagged| {
            lagged + (depth_m - lagged) * (dt_s / (dt_s + delay_s.max(0.0)))
        });
        self.depth_lagged_m = Some(lagged);
        self.bound(lagged, force_n, least_n_per_m, dt_s);
        let keep = (-dt_s / MEMORY_S).exp();
        self.weight = self.weight * keep + 1.0;
        let gain = 1.0 / self.weight;
        let (depth, force) = (lagged - self.depth_mean, force_n - self.force_mean);
        self.depth_mean += gain * depth;
        self.force_mean += gain * force;
        self.depth_var = self.depth_var * keep + depth * (lagged - self.depth_mean);
        self.force_var = self.force_var * keep + force * (force_n - self.force_mean);
        self.covariance = self.covariance * keep + depth * (force_n - self.force_mean);
        let together = self.covariance * self.covariance;
        if self.depth_var / self.weight < SPREAD_MIN_M * SPREAD_MIN_M
            || self.covariance <= 0.0
            || together < CORRELATION_MIN * self.depth_var * self.force_var
        {
            return;
        }
        let ratio = (FORCE_SD_N / DEPTH_SD_M).powi(2);
        let excess = self.force_var - ratio * self.depth_var;
        let slope =
            (excess + (excess * excess + 4.0 * ratio * together).sqrt()) / (2.0 * self.covariance);
        let least_n_per_m = least_n_per_m.min(self.value_n_per_m);
        let measured = slope.clamp(BELIEVED.0, BELIEVED.1).max(least_n_per_m);
        self.known = true;
        self.settled = measured > SETTLED_SHARE * self.value_n_per_m;
        // A higher stiffness is adopted at once, because the loop may be ringing. A lower one is
        // adopted slowly: it only makes the loop faster.
        let share = if measured > self.value_n_per_m {
            1.0
        } else {
            dt_s / (dt_s + LOWER_S)
        };
        self.value_n_per_m += share * (measured - self.value_n_per_m);
    }

    /// Lowers the stiffness in use to what the force since the touch allows.
    fn bound(&mut self, depth_m: f64, force_n: f64, least_n_per_m: f64, dt_s: f64) {
        let since = self.since.get_or_insert(Since {
            depth_m,
            force_n,
            mean_n: force_n,
        });
        since.mean_n += (force_n - since.mean_n) * (dt_s / (dt_s + MEAN_S));
        let least_n_per_m = least_n_per_m.max(MOST_LEAST_N_PER_M);
        let most = since.most_n_per_m(depth_m).max(least_n_per_m);
        if most < self.value_n_per_m {
            self.value_n_per_m += (most - self.value_n_per_m) * (dt_s / (dt_s + LOWER_S));
        }
    }

    /// Takes the contact to be stiffer by `factor` than it is believed to be: the loop rings.
    pub fn stiffen(&mut self, factor: f64) {
        self.value_n_per_m = (self.value_n_per_m * factor).min(BELIEVED.1);
    }

    /// Discards the samples and keeps the value: the next touch is at another place.
    pub fn restart(&mut self) {
        *self = Self {
            value_n_per_m: self.value_n_per_m,
            known: self.known,
            ..Self::new(self.value_n_per_m)
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learn(k: f64, noise_n: f64) -> Stiffness {
        let mut stiffness = Stiffness::new(10_000.0);
        let mut depth = 0.0;
        for i in 0..250u32 {
            // The force rises to 3 N and stays.
            depth += (3.0 / k - depth) * 0.02;
            let noise = noise_n * f64::from(i * 7919 % 101) / 50.0 - noise_n;
            stiffness.update(0.4 + depth, k * depth + noise, 0.0, 0.0, 0.008);
        }
        stiffness
    }

    #[test]
    fn finds_soft_and_stiff() {
        for k in [1e3, 5e3, 1e4, 2.5e4] {
            let found = learn(k, 0.0);
            assert!(found.is_known());
            assert!(
                (found.value_n_per_m() / k - 1.0).abs() < 0.1,
                "{k}: {found:?}"
            );
            let noisy = learn(k, 0.1);
            assert!(
                (0.5..2.0).contains(&(noisy.value_n_per_m() / k)),
                "{k}: {noisy:?}"
            );
        }
    }

    #[test]
    fn settles_when_the_value_in_use_has_come_down() {
        let mut stiffness = Stiffness::new(50_000.0);
        let (mut settled_at, mut depth) = (None, 0.0);
        for _ in 0..100 {
            depth += (3.0 / 5e3 - depth) * 0.02;
            stiffness.update(depth, 5e3 * depth, 0.0, 0.0, 0.008);
            if stiffness.is_settled() && settled_at.is_none() {
                settled_at = Some(stiffness.value_n_per_m());
            }
        }
        assert!(settled_at.is_some_and(|k| k < 6.5e3), "{settled_at:?}");
        stiffness.restart();
        assert!(!stiffness.is_settled() && stiffness.is_known());
    }

    #[test]
    fn a_contact_that_gives_without_a_force_is_soft() {
        // A foam that begins with 150 N/m, and a force of 0.1 N of noise.
        let mut stiffness = Stiffness::new(50_000.0);
        for i in 0..500u32 {
            let depth = 2e-6 * f64::from(i);
            let noise = 0.1 * (f64::from(i) * 0.11).sin();
            stiffness.update(depth, 150.0 * depth + noise, 0.0, 0.0, 0.008);
        }
        let found = stiffness.value_n_per_m();
        assert!(found < 6_000.0, "{found}");
    }

    #[test]
    fn is_not_lowered_below_the_least_but_keeps_a_lower_value() {
        let touch = |from_n_per_m, least_n_per_m| {
            let mut stiffness = Stiffness::new(from_n_per_m);
            let mut depth = 0.0;
            for _ in 0..250 {
                depth += (3.0 / 5e3 - depth) * 0.02;
                stiffness.update(depth, 5e3 * depth, least_n_per_m, 0.0, 0.008);
            }
            stiffness.value_n_per_m()
        };
        assert!((touch(50_000.0, 20_000.0) / 20_000.0 - 1.0).abs() < 0.01);
        assert!((touch(6_000.0, 20_000.0) / 6_000.0 - 1.0).abs() < 0.01);
        assert!((touch(50_000.0, 0.0) / 5_000.0 - 1.0).abs() < 0.1);
    }

    #[test]
    fn noise_without_motion_teaches_nothing() {
        let mut stiffness = Stiffness::new(8_000.0);
        for i in 0..500 {
            let sign = f64::from(i % 2) - 0.5;
            stiffness.update(1.0 + 1e-6 * sign, 3.0 + sign, 0.0, 0.0, 0.008);
        }
        assert_eq!(stiffness.value_n_per_m(), 8_000.0);
        assert!(!stiffness.is_known());
    }

    /// The bug: 3 N on 60 kN/m are 50 um, the arm's gears alone make 30 um, and the contact was
    /// believed to be a tenth as stiff as it is.
    #[test]
    fn gear_ripple_does_not_make_a_stiff_contact_soft() {
        for k in [3e4, 6e4, 1e5] {
            for force_n in [1.2, 3.0, 10.0] {
                let mut stiffness = Stiffness::new(50_000.0);
                let mut lowest = f64::INFINITY;
                for i in 0..400u32 {
                    let t = f64::from(i) * 0.008;
                    let force = force_n * (1.0 - (-t / 0.2).exp());
                    let ripple = 3e-5 * (11.0 * t).sin();
                    stiffness.update(0.4 + force / k + ripple, force, 0.0, 0.0, 0.008);
                    lowest = lowest.min(stiffness.value_n_per_m());
                }
                assert!(lowest > 0.5 * k.min(5e4), "{k}, {force_n} N: {lowest}");
            }
        }
    }
}
