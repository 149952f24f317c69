//! `unified_force_impedance` in a world that is not as it should be: any surface, any policy,
//! somebody who pushes, a camera that lies.

// A world's numbers are also read by what prints it.
#![allow(dead_code)]

use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;
use tangent_control::{Fault, Phase, VisionInput};
use tangent_simulation::{TactileCycle, TactileDisturbance, evaluate_tactile_with};

use crate::energy_balance::{Balance, EXACT};
use crate::tactile_cells::scenario;

/// One world with the task in it.
#[derive(Clone, Copy, Debug)]
pub struct World {
    pub stiffness_n_per_m: f64,
    pub friction: f64,
    pub force_n: f64,
    pub radius_m: f64,
    pub turn_rate_rad_per_s: f64,
    pub rough: Rough,
    /// Energy in the motion tank and in the force tank at the start.
    pub tanks_j: [f64; 2],
    pub paper: bool,
    pub seed: u64,
}

/// Somebody pushes, and the camera sees what it likes.
#[derive(Clone, Copy, Debug)]
pub struct Rough {
    /// Amplitude, N, base axes.
    pub force_n: [f64; 3],
    /// Amplitude, Nm, base axes.
    pub moment_nm: [f64; 3],
    pub push_rad_per_s: f64,
    /// Amplitude of the lie, rad.
    pub view_rad: [f64; 2],
}

impl TactileDisturbance for Rough {
    fn vision(&mut self, time_s: f64, mut normal: VisionInput) -> Option<VisionInput> {
        let axis = Vector3::new(self.view_rad[0], self.view_rad[1], 0.0) * (3.0 * time_s).sin();
        normal.normal = (normal.normal + axis.cross(&normal.normal)).normalize();
        Some(normal)
    }

    fn push(&mut self, time_s: f64) -> Vector6<f64> {
        let (f, m) = (self.force_n, self.moment_nm);
        Vector6::new(f[0], f[1], f[2], m[0], m[1], m[2]) * (self.push_rad_per_s * time_s).sin()
    }
}

/// What a run in a world showed.
#[derive(Debug, Default)]
pub struct Played {
    pub slid: bool,
    /// What ended the task.
    pub fault: Option<Fault>,
    pub motion: Span,
    pub force: Span,
    pub short_j: f64,
    pub balance: Balance,
    /// Fastest joint over the speed that the robot's maker allows it.
    pub speed_share: f64,
}

impl World {
    /// Runs the task, showing every cycle to `watch`.
    pub fn play(&self, mut watch: impl FnMut(&TactileCycle<'_>)) -> Played {
        let rate = self.turn_rate_rad_per_s;
        let rate = if rate.abs() < 0.3 { 0.3 } else { rate };
        let preset = if self.paper { "paper" } else { "default" };
        let set = [
            format!("controller=\"{preset}\""),
            format!("seed={}", self.seed),
            format!("plant.contact.stiffness_n_per_m={}", self.stiffness_n_per_m),
            format!(
                "plant.contact.friction.coulomb_coefficient={}",
                self.friction
            ),
            format!(
                "plant.contact.friction.static_coefficient={}",
                self.friction * 1.1
            ),
            format!("task.force.reference_n={}", self.force_n),
            format!("task.path.radius_m={}", self.radius_m),
            format!("task.path.turn_rate_rad_per_s={rate}"),
            format!("control.tanks.motion.initial_j={}", self.tanks_j[0]),
            format!("control.tanks.force.initial_j={}", self.tanks_j[1]),
            "plant.arm.sub_steps=8".to_owned(),
            // Somebody pushes at the tare too: that ends no task here.
            "control.touch.zero_max_n=100.0".to_owned(),
            "control.touch.align_s=2.0".to_owned(),
            "control.monitor.rate_per_s=8.0".to_owned(),
            "limits.force_max_n=500.0".to_owned(),
            "limits.torque_max_nm=100.0".to_owned(),
            "task.path.duration_s=4.0".to_owned(),
            "duration_s=16.0".to_owned(),
        ];
        let mut set: Vec<&str> = set.iter().map(String::as_str).collect();
        set.extend(EXACT);
        let mut played = Played::default();
        let mut rough = self.rough;
        evaluate_tactile_with(&scenario(&set), &mut rough, |c| {
            played.balance.see(c);
            let tanks = c.output.tanks;
            played.motion.see(tanks.motion_j);
            played.force.see(tanks.force_j);
            played.short_j = played.short_j.max(tanks.short_j);
            played.slid |= c.output.phase == Phase::Slide;
            played.fault = c.output.fault;
            let arm = c.plant.arm();
            let top = arm.model().limits().velocity;
            for i in 0..7 {
                played.speed_share = played.speed_share.max((arm.qd[i] / top[i]).abs());
            }
            watch(c);
        })
        .unwrap();
        played
    }
}

impl Played {
    /// No tank beyond its limits, none short, and every joule accounted for.
    ///
    /// # Errors
    /// What does not hold, with its number.
    pub fn judge(&self) -> Result<(), String> {
        if !self.motion.within(1.0, 32.0) {
            return Err(format!("motion tank {:?}", self.motion));
        }
        if !self.force.within(1.0, 2.0) {
            return Err(format!("force tank {:?}", self.force));
        }
        if self.short_j != 0.0 {
            return Err(format!("short of {} J", self.short_j));
        }
        // What the integration of the plant itself is good to.
        let most = 0.02 + 0.01 * self.balance.turnover_j;
        let off = self.balance.worst_j;
        if off.is_nan() || off >= most {
            return Err(format!("{off} J of {}", self.balance.turnover_j));
        }
        Ok(())
    }
}

/// Any world, any policy, any lie of the camera, any energy at the start.
pub fn anything() -> impl Strategy<Value = World> {
    (
        (
            5e3f64..2e5,
            0.0f64..0.7,
            3.0f64..30.0,
            0.01f64..0.06,
            -3.0f64..3.0,
        ),
        (
            prop::array::uniform3(-15.0f64..15.0),
            prop::array::uniform3(-2.0f64..2.0),
            0.5f64..20.0,
            prop::array::uniform2(-0.3f64..0.3),
        ),
        (1.5f64..32.0, 1.2f64..2.0, any::<bool>(), 0u64..1000),
    )
        .prop_map(|(world, rough, start)| World {
            stiffness_n_per_m: world.0,
            friction: world.1,
            force_n: world.2,
            radius_m: world.3,
            turn_rate_rad_per_s: world.4,
            rough: Rough {
                force_n: rough.0,
                moment_nm: rough.1,
                push_rad_per_s: rough.2,
                view_rad: rough.3,
            },
            tanks_j: [start.0, start.1],
            paper: start.2,
            seed: start.3,
        })
}

/// Least and greatest of something.
#[derive(Debug)]
pub struct Span(f64, f64);

impl Default for Span {
    fn default() -> Self {
        Self(f64::INFINITY, f64::NEG_INFINITY)
    }
}

impl Span {
    fn see(&mut self, value: f64) {
        *self = Self(self.0.min(value), self.1.max(value));
    }

    fn within(&self, least: f64, most: f64) -> bool {
        self.0 >= least && self.1 <= most
    }
}
