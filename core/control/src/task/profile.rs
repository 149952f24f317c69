//! The time law along one stretch of path: from rest to rest, with bounded speed, acceleration and
//! jerk.
//!
//! Speed rises as `v u²(3 - 2u)` over the ramp, stays, and falls the same way: position, speed and
//! acceleration are continuous, and the distance is exact in closed form.

/// A rest-to-rest motion over a length.
///
/// ```
/// use tangent_control::Profile;
///
/// // 0.2 m at 0.02 m/s, within 0.1 m/s² and 1 m/s³.
/// let profile = Profile::new(0.2, 0.02, 0.1, 1.0);
/// let end_s = profile.duration_s();
/// let (distance_m, speed_m_per_s) = profile.at(0.5 * end_s);
/// assert!((distance_m - 0.1).abs() < 1e-12);
/// assert_eq!(speed_m_per_s, 0.02);
/// assert_eq!(profile.at(end_s), (0.2, 0.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    length_m: f64,
    speed_m_per_s: f64,
    ramp_s: f64,
    cruise_s: f64,
}

impl Profile {
    /// Profile over `length_m` at no more than `speed_m_per_s`; all bounds are positive.
    pub fn new(
        length_m: f64,
        speed_m_per_s: f64,
        acceleration_m_per_s2: f64,
        jerk_m_per_s3: f64,
    ) -> Self {
        // The ramp's peak acceleration is 1.5 v / T, its peak jerk 6 v / T².
        let ramp = |v: f64| (1.5 * v / acceleration_m_per_s2).max((6.0 * v / jerk_m_per_s3).sqrt());
        let mut speed = speed_m_per_s;
        if speed * ramp(speed) > length_m {
            // Too short to reach the speed: the two ramps alone cover the length.
            let by_acceleration = (length_m * acceleration_m_per_s2 / 1.5).sqrt();
            let by_jerk = (length_m * length_m * jerk_m_per_s3 / 6.0).cbrt();
            speed = by_acceleration.min(by_jerk);
        }
        let ramp_s = if length_m > 0.0 { ramp(speed) } else { 0.0 };
        let cruise_s = if length_m > 0.0 {
            ((length_m - speed * ramp_s) / speed).max(0.0)
        } else {
            0.0
        };
        Self {
            length_m,
            speed_m_per_s: speed,
            ramp_s,
            cruise_s,
        }
    }

    /// Highest speed, units of the length per s.
    pub(crate) fn speed_max(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Duration from start to end, s.
    pub fn duration_s(&self) -> f64 {
        2.0 * self.ramp_s + self.cruise_s
    }

    /// Distance (m) and speed (m/s) at `time_s` since the start; at rest before and after.
    pub fn at(&self, time_s: f64) -> (f64, f64) {
        let end = self.duration_s();
        if time_s <= 0.0 || end <= 0.0 {
            return (if end <= 0.0 { self.length_m } else { 0.0 }, 0.0);
        }
        if time_s >= end {
            return (self.length_m, 0.0);
        }
        let (v, ramp) = (self.speed_m_per_s, self.ramp_s);
        let rising = |t: f64| {
            let u = t / ramp;
            (
                v * ramp * u * u * u * (1.0 - 0.5 * u),
                v * u * u * (3.0 - 2.0 * u),
            )
        };
        if time_s < ramp {
            return rising(time_s);
        }
        if time_s > end - ramp {
            let (left, speed) = rising(end - time_s);
            return (self.length_m - left, speed);
        }
        (v * (0.5 * ramp + time_s - ramp), v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn goes_the_whole_way_within_its_bounds(length in 1e-4f64..1.0, v in 1e-3f64..0.5, a in 0.02f64..2.0, j in 0.1f64..20.0) {
            let profile = Profile::new(length, v, a, j);
            let end = profile.duration_s();
            prop_assert!((profile.at(end * (1.0 - 1e-12)).0 - length).abs() < 1e-6 * length);
            prop_assert_eq!(profile.at(end + 1.0), (length, 0.0));
            let n = 400;
            let h = end / f64::from(n);
            for i in 1..n {
                let t = h * f64::from(i);
                let (s0, v0) = profile.at(t - h);
                let (s1, v1) = profile.at(t);
                prop_assert!(s1 >= s0 && v1 <= v * (1.0 + 1e-9) && v1 >= 0.0);
                prop_assert!((v1 - v0).abs() / h <= a * (1.0 + 1e-6));
                // The speed is the distance's derivative: Simpson's rule over the step, with an
                // error of at most a jump of the jerk.
                let middle = profile.at(t - 0.5 * h).1;
                let simpson = (v0 + 4.0 * middle + v1) * h / 6.0;
                prop_assert!((s1 - s0 - simpson).abs() <= (j * h * h * h).min(v * h) + 1e-12);
            }
        }
    }

    #[test]
    fn a_long_stretch_takes_length_over_speed_plus_one_ramp() {
        let profile = Profile::new(0.2, 0.02, 0.1, 1.0);
        let ramp = (6.0f64 * 0.02).sqrt().max(0.3);
        assert!((profile.duration_s() - (0.2 / 0.02 + ramp)).abs() < 1e-12);
    }

    #[test]
    fn nowhere_takes_no_time() {
        assert_eq!(Profile::new(0.0, 0.02, 0.1, 1.0).duration_s(), 0.0);
    }
}
