//! The arm as seen through its manufacturer's controller: a velocity servo with a delay, a limit
//! and a lag.

use serde::{Deserialize, Serialize};
use tangent_mechanics::{Joints, Limits};

use super::measurement::VelocityCommand;

/// Velocity servo of the arm: a delay, an acceleration limit and a lag.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServoConfig {
    /// Time between packets, s: 0.008 on CB3, 0.002 on e-Series.
    pub period_s: f64,
    /// Whole periods between a command's arrival and the target velocity that follows it.
    pub input_delay_cycles: usize,
    /// Lag from target velocity to velocity.
    pub lag: Lag,
    /// Highest joint acceleration, whatever the command requests, rad/s².
    pub acceleration_max_rad_per_s2: f64,
    /// Resolution of measured joint positions, rad; 0 for none.
    pub encoder_resolution_rad: f64,
    /// Resolution of measured joint velocities, rad/s; 0 for none.
    pub velocity_resolution_rad_per_s: f64,
}

impl Default for ServoConfig {
    fn default() -> Self {
        Self::cb3()
    }
}

impl ServoConfig {
    /// CB3: 24-40 ms from command to measurable velocity, including the one cycle that a command
    /// waits for the program to read it.
    pub fn cb3() -> Self {
        Self {
            period_s: 0.008,
            input_delay_cycles: 1,
            lag: Lag::FirstOrder {
                time_constant_s: 0.012,
            },
            acceleration_max_rad_per_s2: 15.0,
            encoder_resolution_rad: 0.0,
            velocity_resolution_rad_per_s: 0.0,
        }
    }

    /// e-Series: 6-12 ms from command to measurable velocity in all.
    pub fn e_series() -> Self {
        Self {
            period_s: 0.002,
            input_delay_cycles: 1,
            lag: Lag::FirstOrder {
                time_constant_s: 0.005,
            },
            acceleration_max_rad_per_s2: 20.0,
            encoder_resolution_rad: 0.0,
            velocity_resolution_rad_per_s: 0.0,
        }
    }
}

/// Dynamics from target velocity to velocity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Lag {
    /// `T v' = v_target - v`
    FirstOrder {
        /// `T`, s.
        time_constant_s: f64,
    },
    /// `v'' = w² (v_target - v) - 2 z w v'`
    SecondOrder {
        /// `w`, rad/s.
        natural_frequency_rad_per_s: f64,
        /// `z`
        damping_ratio: f64,
    },
}

/// Longest input delay, cycles.
pub const DELAY_CYCLES_MAX: usize = 32;

/// State of the arm's joints.
///
/// ```
/// use tangent_mechanics::{Arm, Joints, ModelData};
/// use tangent_simulation::{Servo, ServoConfig, VelocityCommand};
///
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// let mut servo = Servo::new(&ServoConfig::e_series(), arm.limits(), Joints::<6>::zeros());
/// let mut command = VelocityCommand::hold();
/// command.qd[0] = 0.1;
///
/// // Periods of 2 ms. After the first, the arm has hardly moved; after 0.2 s it has the speed.
/// for period in 0..100 {
///     let active = servo.exchange(&command);
///     servo.step(&active, 0.002);
///     if period == 0 {
///         assert!(servo.qd[0] < 0.01);
///     }
/// }
/// assert!((servo.qd[0] - 0.1).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Servo {
    config: ServoConfig,
    lower: Joints<6>,
    upper: Joints<6>,
    speed_max: Joints<6>,
    /// Bandwidth of each joint relative to `config.lag`; `None`: equal in all joints.
    bandwidth_ratio: Option<Joints<6>>,
    /// Commands in transit, oldest first.
    line: [VelocityCommand; DELAY_CYCLES_MAX],
    /// True joint positions, rad.
    pub q: Joints<6>,
    /// True joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Joint accelerations, rad/s².
    pub qdd: Joints<6>,
    /// Target positions of the servo, rad.
    pub q_target: Joints<6>,
    /// Target velocities of the servo, rad/s.
    pub qd_target: Joints<6>,
}

impl Servo {
    /// Servo at rest at `q` (rad), within the arm's `limits`.
    pub fn new(config: &ServoConfig, limits: &Limits<6>, q: Joints<6>) -> Self {
        Self {
            config: config.clone(),
            lower: limits.position_lower,
            upper: limits.position_upper,
            speed_max: limits.velocity,
            bandwidth_ratio: None,
            line: [VelocityCommand::hold(); DELAY_CYCLES_MAX],
            q,
            qd: Joints::<6>::zeros(),
            qdd: Joints::<6>::zeros(),
            q_target: q,
            qd_target: Joints::<6>::zeros(),
        }
    }

    /// The servo with joints of different bandwidth, relative to that of the configuration.
    pub fn with_bandwidth_ratio(mut self, ratio: [f64; 6]) -> Self {
        if ratio != [1.0; 6] {
            self.bandwidth_ratio = Some(Joints::<6>::from(ratio));
        }
        self
    }

    /// Takes the command of this period and returns the one that takes effect in it.
    pub fn exchange(&mut self, command: &VelocityCommand) -> VelocityCommand {
        let delay = self.config.input_delay_cycles.min(DELAY_CYCLES_MAX - 1);
        self.line[delay] = *command;
        let active = self.line[0];
        self.line[..=delay].rotate_left(1);
        active
    }

    /// One sub-step of `dt` (s) under `active`.
    pub fn step(&mut self, active: &VelocityCommand, dt: f64) {
        let acceleration = active
            .acceleration
            .abs()
            .min(self.config.acceleration_max_rad_per_s2);
        // The leading joint accelerates at the limit and the others in proportion, as with
        // `speedj`.
        let wanted =
            Joints::<6>::from_fn(|i, _| active.qd[i].clamp(-self.speed_max[i], self.speed_max[i]));
        let change = wanted - self.qd_target;
        let largest = change.amax();
        let share = if largest > acceleration * dt {
            acceleration * dt / largest
        } else {
            1.0
        };
        let target_before = self.qd_target;
        self.qd_target += change * share;
        self.q_target += (target_before + self.qd_target) * (0.5 * dt);

        let qd_before = self.qd;
        match self.config.lag {
            Lag::FirstOrder { time_constant_s } if self.bandwidth_ratio.is_some() => {
                let ratio = self
                    .bandwidth_ratio
                    .unwrap_or_else(|| Joints::<6>::repeat(1.0));
                let keep = ratio.map(|r| (-dt * r / time_constant_s).exp());
                self.qd = self.qd_target + (self.qd - self.qd_target).component_mul(&keep);
            }
            Lag::SecondOrder {
                natural_frequency_rad_per_s,
                damping_ratio,
            } if self.bandwidth_ratio.is_some() => {
                let ratio = self
                    .bandwidth_ratio
                    .unwrap_or_else(|| Joints::<6>::repeat(1.0));
                for i in 0..6 {
                    let w = natural_frequency_rad_per_s * ratio[i];
                    let pull = (self.qd_target[i] - self.qd[i]) * (w * w * dt);
                    let qdd = (self.qdd[i] + pull)
                        / (1.0 + 2.0 * damping_ratio * w * dt + w * w * dt * dt);
                    self.qd[i] += qdd * dt;
                }
            }
            Lag::FirstOrder { time_constant_s } => {
                let keep = (-dt / time_constant_s).exp();
                self.qd = self.qd_target + (self.qd - self.qd_target) * keep;
            }
            Lag::SecondOrder {
                natural_frequency_rad_per_s: w,
                damping_ratio,
            } => {
                // Implicit in both terms: stable for any step.
                let qdd = (self.qdd + (self.qd_target - self.qd) * (w * w * dt))
                    / (1.0 + 2.0 * damping_ratio * w * dt + w * w * dt * dt);
                self.qd += qdd * dt;
            }
        }
        self.qdd = (self.qd - qd_before) / dt;
        self.q += (qd_before + self.qd) * (0.5 * dt);
        for i in 0..6 {
            // Hard stop: the joint and its target stop.
            if self.q[i] < self.lower[i] || self.q[i] > self.upper[i] {
                self.q[i] = self.q[i].clamp(self.lower[i], self.upper[i]);
                self.q_target[i] = self.q[i];
                self.qd[i] = 0.0;
                self.qd_target[i] = 0.0;
            }
        }
    }

    /// Joint positions measured by the encoders, rad.
    pub fn q_measured(&self) -> Joints<6> {
        self.in_counts(&self.q)
    }

    /// Joint velocities reported by the controller, rad/s.
    pub fn qd_measured(&self) -> Joints<6> {
        self.in_velocity_counts(&self.qd)
    }

    /// Joint positions rounded to the encoders' resolution, rad.
    pub(crate) fn in_counts(&self, q: &Joints<6>) -> Joints<6> {
        let step = self.config.encoder_resolution_rad;
        q.map(|x| quantise(x, step))
    }

    /// Joint velocities rounded to their resolution, rad/s.
    pub(crate) fn in_velocity_counts(&self, qd: &Joints<6>) -> Joints<6> {
        let step = self.config.velocity_resolution_rad_per_s;
        qd.map(|x| quantise(x, step))
    }
}

/// `value` to the nearest multiple of `step`; unchanged when `step` is 0.
pub(crate) fn quantise(value: f64, step: f64) -> f64 {
    if step > 0.0 {
        (value / step).round() * step
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn servo(config: &ServoConfig) -> Servo {
        let limits = Limits {
            position_lower: Joints::<6>::repeat(-6.0),
            position_upper: Joints::<6>::repeat(6.0),
            velocity: Joints::<6>::repeat(3.0),
            acceleration: None,
            jerk: None,
            effort: None,
            effort_rate: None,
        };
        Servo::new(config, &limits, Joints::<6>::zeros())
    }

    /// Time until the velocity has reached 1 - 1/e of a small step.
    fn delay_s(config: &ServoConfig) -> f64 {
        let mut servo = servo(config);
        let command = VelocityCommand {
            qd: Joints::<6>::repeat(0.01),
            acceleration: 1e3,
        };
        let sub = 64;
        let dt = config.period_s / f64::from(sub);
        let mut time = 0.0;
        for _ in 0..100 {
            let active = servo.exchange(&command);
            for _ in 0..sub {
                servo.step(&active, dt);
                time += dt;
                if servo.qd[0] >= 0.01 * (1.0 - (-1.0f64).exp()) {
                    return time;
                }
            }
        }
        panic!("the velocity never came");
    }

    #[test]
    fn the_delay_is_the_one_configured() {
        for cycles in [0, 1, 3] {
            let config = ServoConfig {
                input_delay_cycles: cycles,
                acceleration_max_rad_per_s2: 1e6,
                ..ServoConfig::cb3()
            };
            let expected = cycles as f64 * 0.008 + 0.012;
            let got = delay_s(&config);
            assert!(
                (got - expected).abs() < 3e-4,
                "{cycles} cycles: {got} s, not {expected} s"
            );
        }
    }

    #[test]
    fn with_the_cycle_of_exchange_cb3_and_e_series_are_as_measured_on_real_arms() {
        let total = |config: ServoConfig| config.period_s + delay_s(&config);
        let (cb3, e) = (total(ServoConfig::cb3()), total(ServoConfig::e_series()));
        assert!((0.024..=0.040).contains(&cb3), "{cb3}");
        assert!((0.006..=0.012).contains(&e), "{e}");
    }

    #[test]
    fn a_second_order_lag_settles_on_its_target() {
        let lag = Lag::SecondOrder {
            natural_frequency_rad_per_s: 120.0,
            damping_ratio: 0.8,
        };
        let mut servo = servo(&ServoConfig {
            lag,
            ..ServoConfig::cb3()
        });
        let command = VelocityCommand {
            qd: Joints::<6>::repeat(0.2),
            acceleration: 5.0,
        };
        for _ in 0..100 {
            let active = servo.exchange(&command);
            for _ in 0..8 {
                servo.step(&active, 1e-3);
            }
        }
        assert!((servo.qd[0] - 0.2).abs() < 1e-9);
    }

    #[test]
    fn acceleration_and_speed_stay_inside_their_limits_and_joints_inside_theirs() {
        let mut servo = servo(&ServoConfig::cb3());
        let mut command = VelocityCommand {
            qd: Joints::<6>::repeat(9.0),
            acceleration: 2.0,
        };
        command.qd[1] = 1.0;
        for _ in 0..2000 {
            let active = servo.exchange(&command);
            let before = servo.qd_target;
            servo.step(&active, 1e-3);
            assert!((servo.qd_target - before).amax() <= 2.0 * 1e-3 + 1e-12);
            assert!(servo.qd.amax() <= 3.0 && servo.q.amax() <= 6.0);
        }
    }
}
