//! The force law in a loop of one dimension, with a delayed servo and a lagging sensor.

use std::collections::VecDeque;

use proptest::prelude::*;

use super::super::touchdown::touchdown_speed;
use super::*;
use crate::parameters::presets::Presets;

/// A spring behind a delayed velocity servo with a lagging sensor: the loop in one dimension.
struct Bench {
    stiffness: f64,
    commands: VecDeque<f64>,
    /// Natural frequency of a servo of second order, rad/s; `None`: a lag of 12 ms.
    servo_rad_per_s: Option<f64>,
    acceleration: f64,
    velocity: f64,
    depth: f64,
    force: f64,
    dt: f64,
}

impl Bench {
    fn new(stiffness: f64, dt: f64, delay_s: f64) -> Self {
        let cycles = (delay_s / dt).round().max(1.0) as usize;
        Self {
            stiffness,
            commands: VecDeque::from(vec![0.0; cycles]),
            servo_rad_per_s: None,
            acceleration: 0.0,
            velocity: 0.0,
            depth: 0.0,
            force: 0.0,
            dt,
        }
    }

    /// `into` is the commanded velocity into the surface.
    fn step(&mut self, into: f64) {
        self.commands.push_back(into);
        let wanted = self.commands.pop_front().unwrap_or(0.0);
        let n = 8;
        let h = self.dt / f64::from(n);
        for _ in 0..n {
            match self.servo_rad_per_s {
                None => {
                    self.velocity += (wanted - self.velocity) * (1.0 - (-h / 0.012f64).exp());
                }
                Some(omega) => {
                    let pull = omega * omega * (wanted - self.velocity);
                    self.acceleration += h * (pull - 1.8 * omega * self.acceleration);
                    self.velocity += h * self.acceleration;
                }
            }
            self.depth += self.velocity * h;
            let push = self.stiffness * self.depth.max(0.0);
            self.force += (push - self.force) * (1.0 - (-h / 0.008f64).exp());
        }
    }

    fn sample(&self, settling: bool) -> ForceSample {
        ForceSample {
            wrench: Wrench::new(Vector3::z() * self.force, Vector3::zeros()),
            base_from_tool: Pose::new(
                Vector3::new(0.0, 0.0, -self.depth),
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
            ),
            acting_in_tool_m: Vector3::zeros(),
            normal: Vector3::z(),
            along: Vector3::zeros(),
            ahead_m_per_s: None,
            wrench_delay_s: 0.008,
            settling,
            dt_s: self.dt,
        }
    }
}

/// Touches down at `speed` and presses with 3 N; returns the overshoot in percent and the
/// largest error in the last second, N.
fn touchdown(preset: &str, stiffness: f64, dt: f64, delay_s: f64, speed: f64) -> (f64, f64) {
    touchdown_on(preset, Bench::new(stiffness, dt, delay_s), speed)
}

fn touchdown_on(preset: &str, mut bench: Bench, speed: f64) -> (f64, f64) {
    let config = ControllerConfig::preset(preset).unwrap();
    let limits = Limits::default();
    let mut law = ForceLaw::new(config.force.stiffness_expected_n_per_m);
    let dt = bench.dt;
    while bench.force < 0.6 {
        bench.step(speed);
    }
    law.touch(&config, bench.force, speed);
    let (mut peak, mut worst) = (0.0f64, 0.0f64);
    let cycles = (6.0 / dt) as usize;
    for i in 0..cycles {
        let (out, _) = law.step(&config, &limits, 3.0, &bench.sample(true));
        bench.step(-out);
        peak = peak.max(bench.stiffness * bench.depth);
        if i as f64 * dt > 5.0 {
            worst = worst.max((bench.force - 3.0).abs());
        }
    }
    ((peak / 3.0 - 1.0) * 100.0, worst)
}

#[test]
fn touchdown_is_gentle_from_soft_to_stiff_at_both_rates_told_nothing() {
    let config = ControllerConfig::default();
    let speed = touchdown_speed(&config, 3.0, config.force.stiffness_expected_n_per_m);
    for (dt, delay) in [(0.008, 0.016), (0.008, 0.024), (0.002, 0.006)] {
        for stiffness in [1e3, 2e3, 5e3, 1e4, 2.5e4, 5e4] {
            let (overshoot, worst) = touchdown("default", stiffness, dt, delay, speed);
            assert!(overshoot < 30.0, "{stiffness} at {dt}: {overshoot} %");
            assert!(worst < 0.05, "{stiffness} at {dt}: {worst} N");
        }
    }
}

/// Servos of 10 to 25 Hz behind 1 to 3 cycles, told nothing: the force settles, and its first
/// peak stays within twice the reference or 10 N.
#[test]
fn stable_from_1_to_100_kilonewtons_per_metre_with_slow_servos() {
    let config = ControllerConfig::default();
    let speed = touchdown_speed(&config, 3.0, config.force.stiffness_expected_n_per_m);
    let mut unsettled = Vec::new();
    for (dt, servo_hz, cycles) in [
        (0.008, 10.0, 1.0),
        (0.008, 10.0, 3.0),
        (0.008, 15.0, 1.0),
        (0.008, 15.0, 3.0),
        (0.008, 25.0, 2.0),
        (0.002, 10.0, 1.0),
        (0.002, 15.0, 3.0),
        (0.002, 25.0, 2.0),
    ] {
        for stiffness in [1e3, 3e3, 1e4, 3e4, 6e4, 1e5] {
            let bench = Bench {
                servo_rad_per_s: Some(std::f64::consts::TAU * servo_hz),
                ..Bench::new(stiffness, dt, cycles * dt)
            };
            let (overshoot, worst) = touchdown_on("default", bench, speed);
            let peak_n = 3.0 * (1.0 + 0.01 * overshoot);
            if peak_n > 10.0 || worst > 0.15 {
                unsettled.push((dt, servo_hz, cycles, stiffness, peak_n, worst));
            }
        }
    }
    assert!(unsettled.is_empty(), "{unsettled:#?}");
}

#[test]
fn the_papers_damping_is_for_soft_contacts() {
    assert!(touchdown("paper", 1e3, 0.008, 0.016, 0.005).0 < 5.0);
    let (overshoot, worst) = touchdown("paper", 1.2e4, 0.008, 0.016, 0.005);
    assert!(overshoot > 50.0 && worst > 0.5, "{overshoot} {worst}");
}

#[test]
fn the_papers_law_is_eq_1() {
    let config = ControllerConfig::preset("paper").unwrap();
    let mut law = ForceLaw::new(1e4);
    let bench = Bench::new(1e4, 0.008, 0.016);
    law.touch(&config, 3.0, 0.0);
    let mut speed = 0.0;
    for _ in 0..100 {
        speed = law
            .step(&config, &Limits::default(), 3.0, &bench.sample(true))
            .0;
    }
    // No force, 3 N requested: into the surface at 3/150 m/s.
    assert!((speed + 0.02).abs() < 1e-6, "{speed}");
}

#[test]
fn a_tank_bounds_what_is_put_into_a_surface_that_gives_way_for_ever() {
    let tank = EnergyTank {
        initial_j: 0.3,
        lower_j: 0.05,
        upper_j: 0.5,
        band_j: 0.05,
        reserve_j: 0.01,
    };
    let mut config = ControllerConfig::default();
    config.force.tank = Some(tank);
    let mut law = ForceLaw::new(1e4);
    let mut sample = Bench::new(1e4, 0.008, 0.016).sample(true);
    // Dough: it pushes back with 2 N at any depth, of the 10 N requested.
    sample.wrench = Wrench::new(Vector3::z() * 2.0, Vector3::zeros());
    let mut depth = 0.0;
    for _ in 0..5000 {
        sample.base_from_tool = Pose::new(
            Vector3::new(0.0, 0.0, -depth),
            sample.base_from_tool.rotation(),
        );
        let (speed, _) = law.step(&config, &Limits::default(), 10.0, &sample);
        depth -= speed * sample.dt_s;
    }
    let spent = 2.0 * depth;
    assert!(
        spent > 0.15 && spent <= tank.initial_j - tank.lower_j,
        "{spent} J"
    );
    assert!(law.tank_j().unwrap() >= tank.lower_j);
    // When the tool is pushed out again, the energy returns and it may press once more.
    sample.base_from_tool = Pose::new(Vector3::zeros(), sample.base_from_tool.rotation());
    law.step(&config, &Limits::default(), 10.0, &sample);
    assert!((law.tank_j().unwrap() - tank.initial_j).abs() < 1e-9);
    // A distance over which the tool was moved externally is not work on the surface.
    law.touch(&config, 2.0, 0.0);
    sample.base_from_tool = Pose::new(Vector3::z() * 0.05, sample.base_from_tool.rotation());
    let before = law.tank_j().unwrap();
    law.step(&config, &Limits::default(), 10.0, &sample);
    assert_eq!(law.tank_j().unwrap(), before);
}

proptest! {
    #[test]
    fn speed_and_power_stay_bounded(forces in prop::collection::vec(prop::array::uniform3(-500.0f64..500.0), 1..80)) {
        let (config, limits) = (ControllerConfig::default(), Limits::default());
        let mut law = ForceLaw::new(1e4);
        for force in forces {
            let mut sample = Bench::new(1e4, 0.008, 0.016).sample(true);
            sample.wrench = Wrench::new(Vector3::from(force), Vector3::from(force) * 0.1);
            let (speed, turn) = law.step(&config, &limits, 3.0, &sample);
            prop_assert!(speed.abs() <= config.force.speed_max_m_per_s);
            prop_assert!(-speed * force[2] <= limits.power_max_w + 1e-9);
            prop_assert!(turn.norm() <= config.torque.turn_rate_max_rad_per_s + 1e-9);
        }
    }
}
