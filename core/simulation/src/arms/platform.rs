//! The mobile platform under the arm: its motion and its odometry.
//!
//! Called by the plant. The floor's axes are those of the arm's base at time zero; the surface is
//! fixed to the floor.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::pose_config::PoseConfig;

/// `[plant.base]`: a moving base.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlatformConfig {
    /// Velocity of the base's origin, floor axes, m/s: the peak of an oscillation, or the final
    /// value of a motion in one direction.
    pub velocity_m_per_s: [f64; 3],
    /// Turn rate about the base's origin, floor axes, rad/s: the peak of an oscillation, or the
    /// final value of a rotation in one direction.
    pub turn_rate_rad_per_s: [f64; 3],
    /// Period of a sinusoidal motion, s; 0: motion in one direction without end.
    pub period_s: f64,
    /// Time at which the motion begins, s.
    pub start_s: f64,
    /// Time in which a motion in one direction reaches its final velocity, s.
    pub ramp_s: f64,
    /// Odometry that the platform publishes.
    pub odometry: OdometryConfig,
}

impl Default for PlatformConfig {
    fn default() -> Self {
        Self {
            velocity_m_per_s: [0.0; 3],
            turn_rate_rad_per_s: [0.0; 3],
            period_s: 10.0,
            start_s: 0.0,
            ramp_s: 1.0,
            odometry: OdometryConfig::default(),
        }
    }
}

/// Odometry of the platform. It is ideal if all errors are zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OdometryConfig {
    /// Poses per second; 0: none are published.
    pub rate_hz: f64,
    /// Time from measurement to publication, s.
    pub latency_s: f64,
    /// White noise of the position per axis, m.
    pub position_noise_m: f64,
    /// White noise of the orientation per axis, rad.
    pub orientation_noise_rad: f64,
    /// Random walk of the position per axis, as from slip, m/√s.
    pub position_walk_m_per_sqrt_s: f64,
    /// Random walk of the orientation per axis, as from slip, rad/√s.
    pub orientation_walk_rad_per_sqrt_s: f64,
    /// `world_from_base` at time zero: pose of the floor's axes in the map.
    pub world_from_start: PoseConfig,
    /// Time from which no poses are published, s.
    pub silent_from_s: Option<f64>,
    /// Time at which publication resumes, s.
    pub silent_until_s: Option<f64>,
    /// Time at which the map jumps (relocalisation), s.
    pub jump_at_s: Option<f64>,
    /// Jump of the map, world axes, m.
    pub jump_m: [f64; 3],
}

impl Default for OdometryConfig {
    fn default() -> Self {
        Self {
            rate_hz: 50.0,
            latency_s: 0.0,
            position_noise_m: 0.0,
            orientation_noise_rad: 0.0,
            position_walk_m_per_sqrt_s: 0.0,
            orientation_walk_rad_per_sqrt_s: 0.0,
            world_from_start: PoseConfig::default(),
            silent_from_s: None,
            silent_until_s: None,
            jump_at_s: None,
            jump_m: [0.0; 3],
        }
    }
}

impl PlatformConfig {
    /// The first setting out of its range: its key, its value and what is allowed.
    pub(crate) fn wrong(&self) -> Option<(&'static str, f64, &'static str)> {
        let o = &self.odometry;
        let checks = [
            (
                "base.velocity_m_per_s",
                Vector3::from(self.velocity_m_per_s).norm(),
                0.0,
                1.0,
                "at most 1 m/s",
            ),
            (
                "base.turn_rate_rad_per_s",
                Vector3::from(self.turn_rate_rad_per_s).norm(),
                0.0,
                1.0,
                "at most 1 rad/s",
            ),
            ("base.period_s", self.period_s, 0.0, 3600.0, "0 to 3600 s"),
            ("base.start_s", self.start_s, 0.0, 86_400.0, "0 to 86400 s"),
            ("base.ramp_s", self.ramp_s, 1e-3, 60.0, "0.001 to 60 s"),
            (
                "base.odometry.rate_hz",
                o.rate_hz,
                0.0,
                1000.0,
                "0 to 1000 Hz",
            ),
            ("base.odometry.latency_s", o.latency_s, 0.0, 1.0, "0 to 1 s"),
            (
                "base.odometry.position_noise_m",
                o.position_noise_m,
                0.0,
                1.0,
                "0 to 1 m",
            ),
            (
                "base.odometry.orientation_noise_rad",
                o.orientation_noise_rad,
                0.0,
                1.0,
                "0 to 1 rad",
            ),
            (
                "base.odometry.position_walk_m_per_sqrt_s",
                o.position_walk_m_per_sqrt_s,
                0.0,
                1.0,
                "0 to 1 m/√s",
            ),
            (
                "base.odometry.orientation_walk_rad_per_sqrt_s",
                o.orientation_walk_rad_per_sqrt_s,
                0.0,
                1.0,
                "0 to 1 rad/√s",
            ),
        ];
        checks
            .into_iter()
            .find(|(_, value, lower, upper, _)| !(lower..=upper).contains(&value))
            .map(|(key, value, _, _, allowed)| (key, value, allowed))
    }
}

/// One pose, as published by the platform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometrySample {
    /// Time of measurement, s.
    pub stamp_s: f64,
    /// Time of publication, s.
    pub published_s: f64,
    /// Measured pose of the base, `world_from_base`.
    pub world_from_base: Isometry3<f64>,
    /// Variance of each position axis, m².
    pub position_variance_m2: f64,
    /// Variance of each orientation axis, rad².
    pub orientation_variance_rad2: f64,
}

/// The platform and the state of its odometry.
///
/// ```
/// use tangent_simulation::{Platform, PlatformConfig};
///
/// // 0.1 m/s along x, reached after a ramp of one second that covers half of its distance.
/// let config = PlatformConfig {
///     velocity_m_per_s: [0.1, 0.0, 0.0],
///     period_s: 0.0,
///     ..PlatformConfig::default()
/// };
/// let platform = Platform::new(&config, 1);
/// assert!((platform.pose(3.0).translation.x - 0.25).abs() < 1e-12);
/// ```
#[derive(Clone, Debug)]
pub struct Platform {
    config: PlatformConfig,
    rng: Pcg64Mcg,
    position_walk: Vector3<f64>,
    orientation_walk: Vector3<f64>,
    measured: u64,
    /// Poses measured but not yet published, oldest first.
    under_way: Vec<OdometrySample>,
    published: Vec<OdometrySample>,
}

impl Platform {
    /// Platform at rest at the floor's origin.
    pub fn new(config: &PlatformConfig, seed: u64) -> Self {
        Self {
            rng: Pcg64Mcg::seed_from_u64(seed ^ 0xba5e_0d0e_7a11_c0de),
            position_walk: Vector3::zeros(),
            orientation_walk: Vector3::zeros(),
            measured: 0,
            under_way: Vec::new(),
            published: Vec::new(),
            config: config.clone(),
        }
    }

    /// True pose of the base on the floor, `floor_from_base`, at `time_s`.
    pub fn pose(&self, time_s: f64) -> Isometry3<f64> {
        let c = &self.config;
        let t = (time_s - c.start_s).max(0.0);
        // Distance divided by the peak speed, s.
        let way = if c.period_s > 0.0 {
            let rate = std::f64::consts::TAU / c.period_s;
            (1.0 - (rate * t).cos()) / rate
        } else if t < c.ramp_s {
            let rate = std::f64::consts::PI / c.ramp_s;
            0.5 * (t - (rate * t).sin() / rate)
        } else {
            t - 0.5 * c.ramp_s
        };
        Isometry3::from_parts(
            Translation3::from(Vector3::from(c.velocity_m_per_s) * way),
            UnitQuaternion::new(Vector3::from(c.turn_rate_rad_per_s) * way),
        )
    }

    /// Measures and publishes all poses that are due up to `time_s`.
    pub fn step(&mut self, time_s: f64) {
        self.published.clear();
        let rate_hz = self.config.odometry.rate_hz;
        while rate_hz > 0.0 && (self.measured + 1) as f64 / rate_hz <= time_s + 1e-9 {
            self.measured += 1;
            let sample = self.measure(self.measured as f64 / rate_hz);
            let o = &self.config.odometry;
            let silent = o.silent_from_s.is_some_and(|from| sample.stamp_s >= from)
                && o.silent_until_s.is_none_or(|until| sample.stamp_s < until);
            if !silent {
                self.under_way.push(sample);
            }
        }
        let due = self
            .under_way
            .partition_point(|sample| sample.published_s <= time_s + 1e-9);
        self.published.extend(self.under_way.drain(..due));
    }

    fn measure(&mut self, time_s: f64) -> OdometrySample {
        let o = &self.config.odometry;
        let mut draw = |sd: f64| {
            Vector3::from_fn(|_, _| {
                let x: f64 = StandardNormal.sample(&mut self.rng);
                x * sd
            })
        };
        let step = o.rate_hz.sqrt().recip();
        self.position_walk += draw(o.position_walk_m_per_sqrt_s * step);
        self.orientation_walk += draw(o.orientation_walk_rad_per_sqrt_s * step);
        let (off, turned) = (
            self.position_walk + draw(o.position_noise_m),
            self.orientation_walk + draw(o.orientation_noise_rad),
        );
        let jump = match o.jump_at_s {
            Some(at) if time_s >= at => Vector3::from(o.jump_m),
            _ => Vector3::zeros(),
        };
        let floor_from_base = self.pose(time_s);
        let measured = Isometry3::from_parts(
            Translation3::from(floor_from_base.translation.vector + off),
            UnitQuaternion::new(turned) * floor_from_base.rotation,
        );
        let variance = |noise: f64, walk: f64| noise * noise + walk * walk * time_s;
        OdometrySample {
            stamp_s: time_s,
            published_s: time_s + o.latency_s,
            world_from_base: Translation3::from(jump) * o.world_from_start.isometry() * measured,
            position_variance_m2: variance(o.position_noise_m, o.position_walk_m_per_sqrt_s),
            orientation_variance_rad2: variance(
                o.orientation_noise_rad,
                o.orientation_walk_rad_per_sqrt_s,
            ),
        }
    }

    /// Poses published in the last step, oldest first.
    pub fn published(&self) -> &[OdometrySample] {
        &self.published
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn swings_and_goes_straight_at_the_stated_speed() {
        for (period_s, at) in [(10.0, 2.5), (0.0, 20.0)] {
            let config = PlatformConfig {
                velocity_m_per_s: [0.02, 0.0, 0.0],
                turn_rate_rad_per_s: [0.0, 0.0, 0.01],
                period_s,
                start_s: 1.0,
                ..PlatformConfig::default()
            };
            let platform = Platform::new(&config, 1);
            assert_eq!(platform.pose(1.0), Isometry3::identity());
            let h = 1e-4;
            let (before, after) = (platform.pose(1.0 + at - h), platform.pose(1.0 + at + h));
            let velocity = (after.translation.vector - before.translation.vector) / (2.0 * h);
            let turn = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * h);
            assert!((velocity.x - 0.02).abs() < 1e-7, "{velocity}");
            assert!((turn.z - 0.01).abs() < 1e-7, "{turn}");
            let start = platform.pose(1.0 + h).translation.vector.norm() / h;
            assert!(start < 1e-5, "starts from rest: {start}");
        }
    }

    #[test]
    fn odometry_comes_late_noisy_and_says_so() {
        let config = PlatformConfig {
            odometry: OdometryConfig {
                latency_s: 0.05,
                position_noise_m: 0.001,
                silent_from_s: Some(30.0),
                ..OdometryConfig::default()
            },
            ..PlatformConfig::default()
        };
        let mut platform = Platform::new(&config, 3);
        let (mut count, mut square) = (0, 0.0);
        for cycle in 1..=5000 {
            let now = 0.008 * f64::from(cycle);
            platform.step(now);
            for sample in platform.published() {
                assert!(sample.published_s <= now + 1e-9 && sample.published_s > now - 0.0081);
                assert!((sample.published_s - sample.stamp_s - 0.05).abs() < 1e-12);
                count += 3;
                square += sample.world_from_base.translation.vector.norm_squared();
            }
        }
        assert_eq!(count, 3 * (30 * 50 - 1));
        let sd = (square / f64::from(count)).sqrt();
        assert!((sd - 0.001).abs() < 1e-4, "{sd}");
    }
}
