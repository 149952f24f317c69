//! Model of the force/torque sensor: saturation of the gauges, drift of the zero, noise and
//! quantisation.

use nalgebra::{Matrix6, Vector6};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::fault::SensorFault;
use super::sample::SensorSample;
use crate::arms::servo::quantise;
use crate::plant_error::PlantError;

/// Force/torque sensor. The default has no errors: ideal sensing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// Samples per second: 1000 in `evaluate`, 7000 live.
    pub rate_hz: f64,
    /// Counts per N, as in `cfgcpf` of the sensor box.
    pub counts_per_n: f64,
    /// Counts per Nm, as in `cfgcpt` of the sensor box.
    pub counts_per_nm: f64,
    /// Rated forces `[Fx, Fy, Fz]`, N. The gauges saturate slightly above; `[0, 0, 0]` never
    /// saturates.
    pub range_n: [f64; 3],
    /// Rated torques `[Tx, Ty, Tz]`, Nm. The gauges saturate slightly above; `[0, 0, 0]` never
    /// saturates.
    pub range_nm: [f64; 3],
    /// Resolution of the force readings, N; 0 for that of the counts.
    pub resolution_n: [f64; 3],
    /// Resolution of the torque readings, Nm; 0 for that of the counts.
    pub resolution_nm: [f64; 3],
    /// White noise of the forces, N/√Hz, one-sided: `σ = density √(rate/2)`.
    pub noise_n_per_sqrt_hz: f64,
    /// White noise of the torques, Nm/√Hz, one-sided: `σ = density √(rate/2)`.
    pub noise_nm_per_sqrt_hz: f64,
    /// Force zero of the untared sensor: standard deviation over seeds, N.
    pub bias_n: f64,
    /// Torque zero of the untared sensor: standard deviation over seeds, Nm.
    pub bias_nm: f64,
    /// Warm-up drift of the force zero, in a direction drawn from the seed, N.
    pub drift_n: f64,
    /// Warm-up drift of the torque zero, in a direction drawn from the seed, Nm.
    pub drift_nm: f64,
    /// Time constant of the warm-up, s.
    pub drift_time_constant_s: f64,
    /// Random walk of the force zero, N/√s.
    pub walk_n_per_sqrt_s: f64,
    /// Fault of the sensor and its start time; no fault if absent.
    pub fault: Option<SensorFault>,
}

impl SensorConfig {
    /// Checks that fault and rate are in their ranges.
    ///
    /// # Errors
    /// A setting is out of its range; the error names the key and what is allowed.
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        if let Some((key, x, allowed)) = self.fault.and_then(|fault| fault.mistake()) {
            PlantError::unless(key, x, allowed, false)?;
        }
        PlantError::unless(
            "sensor.rate_hz",
            self.rate_hz,
            "125 to 7000",
            (125.0..=7000.0).contains(&self.rate_hz),
        )
    }
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self::ideal()
    }
}

impl SensorConfig {
    /// Ideal sensor: no noise, no drift, no ranges, quantised only by the counts of the wire
    /// format.
    pub fn ideal() -> Self {
        Self {
            rate_hz: 1000.0,
            counts_per_n: 1e6,
            counts_per_nm: 1e6,
            range_n: [0.0; 3],
            range_nm: [0.0; 3],
            resolution_n: [0.0; 3],
            resolution_nm: [0.0; 3],
            noise_n_per_sqrt_hz: 0.0,
            noise_nm_per_sqrt_hz: 0.0,
            bias_n: 0.0,
            bias_nm: 0.0,
            drift_n: 0.0,
            drift_nm: 0.0,
            drift_time_constant_s: 10.0,
            walk_n_per_sqrt_s: 0.0,
            fault: None,
        }
    }

    /// ATI Gamma SI-130-10 on a Net F/T box, cold: ranges and resolution as rated, 0.3 N of drift.
    pub fn gamma() -> Self {
        Self {
            rate_hz: 1000.0,
            counts_per_n: 1e6,
            counts_per_nm: 1e6,
            range_n: [130.0, 130.0, 400.0],
            range_nm: [10.0; 3],
            resolution_n: [1.0 / 40.0, 1.0 / 40.0, 1.0 / 20.0],
            resolution_nm: [1.0 / 800.0; 3],
            noise_n_per_sqrt_hz: 0.002,
            noise_nm_per_sqrt_hz: 6e-5,
            bias_n: 2.0,
            bias_nm: 0.1,
            drift_n: 0.3,
            drift_nm: 0.01,
            drift_time_constant_s: 10.0,
            walk_n_per_sqrt_s: 0.005,
            fault: None,
        }
    }
}

/// Share of a gauge's range that one rated load alone takes up.
const RATED_SHARE: f64 = 0.98;

/// Steps of the random walk per second. The rate is fixed, so that the walk is the same at every
/// sample rate.
const WALK_RATE_HZ: f64 = 100.0;

/// Sensor with its state. One [`Sensor::read`] per sample.
///
/// ```
/// use nalgebra::Vector6;
/// use tangent_simulation::{Sensor, SensorConfig};
///
/// let pressing = Vector6::new(0.0, 0.0, -3.0, 0.0, 0.0, 0.0);
/// // A million counts per newton, no noise and no bias.
/// let mut ideal = Sensor::new(&SensorConfig::ideal(), 1);
/// assert_eq!(ideal.read(0.0, &pressing).counts, [0, 0, -3_000_000, 0, 0, 0]);
///
/// // A real one has an unknown zero and saturates.
/// let mut gamma = Sensor::new(&SensorConfig::gamma(), 1);
/// assert_ne!(gamma.read(0.0, &pressing).counts[2], -3_000_000);
/// assert!(gamma.read(0.001, &(pressing * 1000.0)).saturated);
/// ```
#[derive(Clone, Debug)]
pub struct Sensor {
    config: SensorConfig,
    /// Gauge readings per wrench, where 1 is the end of a gauge's range, and the inverse; `None` if
    /// the sensor never saturates.
    gauges: Option<(Matrix6<f64>, Matrix6<f64>)>,
    rng: Pcg64Mcg,
    /// Zero of the cold, untared sensor, N and Nm.
    offset: Vector6<f64>,
    /// Final warm-up drift of the zero, N and Nm.
    drift: Vector6<f64>,
    walk: Vector6<f64>,
    walk_rng: Pcg64Mcg,
    walk_steps: u64,
    noise: Vector6<f64>,
}

impl Sensor {
    /// Creates a sensor; `seed` determines its offset and the direction of its drift.
    pub fn new(config: &SensorConfig, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x5e45_0f00_d5ea_50f5);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut offset = Vector6::from_fn(|_, _| normal());
        let mut drift = Vector6::from_fn(|_, _| normal());
        for (vector, force, torque) in [
            (&mut offset, config.bias_n, config.bias_nm),
            (&mut drift, config.drift_n, config.drift_nm),
        ] {
            for i in 0..6 {
                vector[i] *= if i < 3 { force } else { torque };
            }
        }
        // Only the direction of the drift is random; its size is given.
        for (start, size) in [(0, config.drift_n), (3, config.drift_nm)] {
            let mut part = drift.fixed_rows_mut::<3>(start);
            let length = part.norm();
            if length > 0.0 {
                part *= size / length;
            }
        }
        let spread = (config.rate_hz / 2.0).sqrt();
        let noise = Vector6::from_fn(|i, _| {
            spread
                * if i < 3 {
                    config.noise_n_per_sqrt_hz
                } else {
                    config.noise_nm_per_sqrt_hz
                }
        });
        Self {
            gauges: gauge_matrix(config),
            rng,
            offset,
            drift,
            walk: Vector6::zeros(),
            walk_rng: Pcg64Mcg::seed_from_u64(seed ^ 0x0a1c_77e5_3b90_d2f6),
            walk_steps: 0,
            noise,
            config: config.clone(),
        }
    }

    /// Current zero of the sensor, N and Nm: what an ideal tare would remove.
    pub fn bias(&self, time_s: f64) -> Vector6<f64> {
        let warm = 1.0 - (-time_s / self.config.drift_time_constant_s).exp();
        self.offset + self.drift * warm + self.walk
    }

    /// One record of the true wrench on the sensor (N, Nm, sensor axes) at `time_s`.
    pub fn read(&mut self, time_s: f64, wrench: &Vector6<f64>) -> SensorSample {
        let mut reading = *wrench;
        let mut saturated = false;
        if let Some((gauge_from_wrench, wrench_from_gauge)) = &self.gauges {
            let mut gauges = multiply(gauge_from_wrench, wrench);
            for gauge in gauges.iter_mut() {
                if gauge.abs() > 1.0 {
                    *gauge = gauge.clamp(-1.0, 1.0);
                    saturated = true;
                }
            }
            if saturated {
                reading = multiply(wrench_from_gauge, &gauges);
            }
        }
        if self.config.walk_n_per_sqrt_s > 0.0 {
            let step = self.config.walk_n_per_sqrt_s / WALK_RATE_HZ.sqrt();
            while (self.walk_steps as f64) < time_s * WALK_RATE_HZ {
                self.walk_steps += 1;
                for i in 0..3 {
                    let draw: f64 = StandardNormal.sample(&mut self.walk_rng);
                    self.walk[i] += step * draw;
                }
            }
        }
        reading += self.bias(time_s);
        let mut counts = [0; 6];
        for i in 0..6 {
            if self.noise[i] > 0.0 {
                let draw: f64 = StandardNormal.sample(&mut self.rng);
                reading[i] += self.noise[i] * draw;
            }
            let (step, scale) = if i < 3 {
                (self.config.resolution_n[i], self.config.counts_per_n)
            } else {
                (self.config.resolution_nm[i - 3], self.config.counts_per_nm)
            };
            // `as` saturates, as the wire format does for a load beyond its integers.
            counts[i] = (quantise(reading[i], step) * scale).round() as i32;
        }
        SensorSample {
            time_s,
            counts,
            saturated,
        }
    }
}

/// Sums in a fixed order, for the same bits on every platform.
fn multiply(matrix: &Matrix6<f64>, vector: &Vector6<f64>) -> Vector6<f64> {
    Vector6::from_fn(|i, _| (0..6).map(|j| matrix[(i, j)] * vector[j]).sum())
}

/// Three beams at 120°, each with a gauge for bending up and one for bending sideways, as in a
/// Maltese-cross sensor:
///
/// ```text
/// up_i   = Fz/Fz_max + (Tx sin a_i - Ty cos a_i)/T_max
/// side_i = Tz/Tz_max + (Fy cos a_i - Fx sin a_i)/F_max
/// ```
///
/// Loads add up in a gauge: about half of every rated load at once reaches the end of its range.
fn gauge_matrix(config: &SensorConfig) -> Option<(Matrix6<f64>, Matrix6<f64>)> {
    let ([fx, fy, fz], [tx, ty, tz]) = (config.range_n, config.range_nm);
    if [fx, fy, fz, tx, ty, tz].iter().any(|range| *range <= 0.0) {
        return None;
    }
    let mut matrix = Matrix6::zeros();
    for beam in 0..3 {
        let (sin, cos) = (std::f64::consts::TAU * beam as f64 / 3.0).sin_cos();
        matrix[(beam, 2)] = RATED_SHARE / fz;
        matrix[(beam, 3)] = RATED_SHARE * sin / tx;
        matrix[(beam, 4)] = -RATED_SHARE * cos / ty;
        matrix[(beam + 3, 5)] = RATED_SHARE / tz;
        matrix[(beam + 3, 1)] = RATED_SHARE * cos / fy;
        matrix[(beam + 3, 0)] = -RATED_SHARE * sin / fx;
    }
    let inverse = matrix.try_inverse()?;
    Some((matrix, inverse))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rated() -> Vector6<f64> {
        Vector6::new(130.0, 130.0, 400.0, 10.0, 10.0, 10.0)
    }

    fn quiet_gamma() -> SensorConfig {
        let gamma = SensorConfig::gamma();
        SensorConfig {
            range_n: gamma.range_n,
            range_nm: gamma.range_nm,
            ..SensorConfig::ideal()
        }
    }

    #[test]
    fn one_rated_load_alone_is_read_and_somewhat_more_is_not() {
        for axis in 0..6 {
            for sign in [-1.0, 1.0] {
                let mut load = Vector6::zeros();
                load[axis] = sign * rated()[axis];
                let mut sensor = Sensor::new(&quiet_gamma(), 1);
                let sample = sensor.read(0.0, &load);
                assert!(!sample.saturated, "axis {axis}");
                assert_eq!(sample.counts[axis], (load[axis] * 1e6).round() as i32);
                assert!(sensor.read(0.0, &(load * 1.2)).saturated, "axis {axis}");
            }
        }
    }

    #[test]
    fn combined_loads_end_at_about_half_of_every_rated_axis() {
        for signs in 0..64u32 {
            let load =
                Vector6::from_fn(|i, _| rated()[i] * if signs >> i & 1 == 1 { 1.0 } else { -1.0 });
            let mut sensor = Sensor::new(&quiet_gamma(), 1);
            assert!(
                sensor.read(0.0, &(load * 0.55)).saturated,
                "signs {signs:06b}"
            );
            assert!(
                !sensor.read(0.0, &(load * 0.40)).saturated,
                "signs {signs:06b}"
            );
        }
    }

    #[test]
    fn a_saturated_reading_is_plausible_and_wrong() {
        let mut sensor = Sensor::new(&quiet_gamma(), 1);
        let sample = sensor.read(0.0, &(rated() * 0.7));
        assert!(sample.saturated);
        assert!(sample.counts.iter().any(|&c| c != 0));
        assert_ne!(sample.counts[2], (0.7 * 400.0 * 1e6) as i32);
    }

    #[test]
    fn noise_after_a_filter_does_not_depend_on_the_rate() {
        let after_filter = |rate_hz: f64| {
            let config = SensorConfig {
                rate_hz,
                noise_n_per_sqrt_hz: 0.002,
                ..SensorConfig::ideal()
            };
            let mut sensor = Sensor::new(&config, 7);
            // First-order low-pass at 20 Hz: its noise bandwidth is π/2 · 20 Hz.
            let keep = (-std::f64::consts::TAU * 20.0 / rate_hz).exp();
            let (mut state, mut sum) = (0.0, 0.0);
            let n = (60.0 * rate_hz) as usize;
            for i in 0..n {
                let sample = sensor.read(i as f64 / rate_hz, &Vector6::zeros());
                state = keep * state + (1.0 - keep) * f64::from(sample.counts[0]) / 1e6;
                sum += state * state;
            }
            (sum / n as f64).sqrt()
        };
        let expected = 0.002 * (std::f64::consts::FRAC_PI_2 * 20.0f64).sqrt();
        for rate in [1000.0, 7000.0] {
            let got = after_filter(rate);
            assert!(
                (got / expected - 1.0).abs() < 0.08,
                "{rate} Hz: {got} N, not {expected} N"
            );
        }
    }

    #[test]
    fn warm_up_moves_the_zero_by_the_drift_asked_for() {
        let config = SensorConfig {
            drift_n: 0.3,
            ..SensorConfig::ideal()
        };
        let sensor = Sensor::new(&config, 3);
        let moved = sensor.bias(100.0) - sensor.bias(0.0);
        assert!((moved.fixed_rows::<3>(0).norm() - 0.3).abs() < 1e-4);
        assert_eq!(sensor.bias(0.0), Vector6::zeros());
    }

    #[test]
    fn the_random_walk_is_the_same_at_every_rate_and_as_wide_as_asked_for() {
        let walk = |rate_hz: f64, seed| {
            let config = SensorConfig {
                rate_hz,
                walk_n_per_sqrt_s: 0.1,
                ..SensorConfig::ideal()
            };
            let mut sensor = Sensor::new(&config, seed);
            for i in 1..=(4.0 * rate_hz) as usize {
                sensor.read(i as f64 / rate_hz, &Vector6::zeros());
            }
            sensor.bias(4.0)
        };
        assert_eq!(walk(1000.0, 5), walk(7000.0, 5));
        let squares: f64 = (0..100).map(|seed| walk(125.0, seed).norm_squared()).sum();
        let sd = (squares / 300.0).sqrt();
        assert!((sd / 0.2 - 1.0).abs() < 0.15, "{sd} N after 4 s, not 0.2 N");
    }

    #[test]
    fn readings_step_by_the_resolution() {
        let config = SensorConfig {
            resolution_n: [0.025; 3],
            ..SensorConfig::ideal()
        };
        let mut sensor = Sensor::new(&config, 1);
        let load = Vector6::new(1.0 + 0.014, 0.0, 0.0, 0.0, 0.0, 0.0);
        assert_eq!(sensor.read(0.0, &load).counts[0], 1_025_000);
    }
}
