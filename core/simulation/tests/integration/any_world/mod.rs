//! `unified_force_impedance` in adverse worlds: any surface, any policy, external pushes, and a
//! camera with wrong normals.

// Some fields are only read when a world is printed.
#![allow(dead_code)]

use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;
use tangent_control::{Fault, Phase, VisionInput};
use tangent_simulation::{Disturbance, VisuoTactileCycle, evaluate_visuo_tactile_with};

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
    /// Initial energy in the motion tank and in the force tank, J.
    pub tanks_j: [f64; 2],
    pub paper: bool,
    pub seed: u64,
}

/// External pushes, and errors of the camera.
#[derive(Clone, Copy, Debug)]
pub struct Rough {
    /// Amplitude of the force, N, base axes.
    pub force_n: [f64; 3],
    /// Amplitude of the moment, Nm, base axes.
    pub moment_nm: [f64; 3],
    pub push_rad_per_s: f64,
    /// Amplitude of the camera's error, rad.
    pub view_rad: [f64; 2],
}

impl Disturbance for Rough {
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

/// Result of a run in a world.
#[derive(Debug, Default)]
pub struct Played {
    pub slid: bool,
    /// Fault that ended the task.
    pub fault: Option<Fault>,
    pub motion: Span,
    pub force: Span,
    pub short_j: f64,
    pub balance: Balance,
    /// Highest joint speed, as a share of the limit from the robot's manufacturer.
    pub speed_share: f64,
}

impl World {
    /// Runs the task and passes every cycle to `watch`.
    pub fn play(&self, mut watch: impl FnMut(&VisuoTactileCycle<'_>)) -> Played {
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
            // The pushes also act during the tare, which must not end the task here.
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
        evaluate_visuo_tactile_with(&scenario(&set), &mut rough, |c| {
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
    /// Checks that no tank exceeds its limits or lacks energy, and that the energy balance is
    /// closed.
    ///
    /// # Errors
    /// The condition that does not hold, with its number.
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
        // Accuracy of the plant's own integration.
        let most = 0.02 + 0.01 * self.balance.turnover_j;
        let off = self.balance.worst_j;
        if off.is_nan() || off >= most {
            return Err(format!("{off} J of {}", self.balance.turnover_j));
        }
        Ok(())
    }
}

/// Any world, policy, camera error and initial energy.
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

/// Minimum and maximum of a value.
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
