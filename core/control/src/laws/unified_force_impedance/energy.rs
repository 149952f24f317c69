//! The two tanks in use: which tank supplies which work, and what damping returns. Eqs. (34)-(73),
//! over periods instead of instants.
//!
//! A torque that is constant over a period does the work `τ · Δq`, whatever happens within the
//! period. The energy is therefore accounted one period late, from the measured positions, and
//! exact up to rounding; an estimate in advance from the power `τ · q̇` would not be. The published
//! shares count the same dissipation in both tanks (eqs. (39) and (57)); here every joule goes to
//! one of them.

use tangent_mechanics::Joints;

use super::config::TankConfig;
use super::interface::TankBooks;
use crate::contact::energy_tank::{EnergyTankState, smooth};

/// Maximum delay of a torque, periods.
pub(super) const DELAY_MAX: usize = 8;

/// Torques of one period by the source of their energy, Nm. Gravity is in none of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TorqueParts<const N: usize> {
    /// Springs, moving references and feed-forward: supplied by the motion tank.
    pub motion: Joints<N>,
    /// Force controller: supplied by the force tank.
    pub force: Joints<N>,
    /// Dampers: dissipative.
    pub damping: Joints<N>,
}

impl<const N: usize> TorqueParts<N> {
    pub fn zero() -> Self {
        Self {
            motion: Joints::zeros(),
            force: Joints::zeros(),
            damping: Joints::zeros(),
        }
    }

    pub fn sum(&self) -> Joints<N> {
        self.motion + self.force + self.damping
    }

    /// Interpolates from `self` towards `wanted`, by a share for each joint.
    pub fn towards(&self, wanted: &Self, share: &Joints<N>) -> Self {
        let between = |from: &Joints<N>, to: &Joints<N>| from + (to - from).component_mul(share);
        Self {
            motion: between(&self.motion, &wanted.motion),
            force: between(&self.force, &wanted.force),
            damping: between(&self.damping, &wanted.damping),
        }
    }
}

impl<const N: usize> std::ops::Mul<f64> for TorqueParts<N> {
    type Output = Self;

    fn mul(self, share: f64) -> Self {
        Self {
            motion: self.motion * share,
            force: self.force * share,
            damping: self.damping * share,
        }
    }
}

/// Both tanks and the torques that are not yet in effect.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tanks<const N: usize> {
    motion: EnergyTankState,
    force: EnergyTankState,
    /// Committed torques, newest first.
    under_way: [TorqueParts<N>; DELAY_MAX + 1],
    last_q: Option<Joints<N>>,
    work_j: f64,
    dissipated_j: f64,
    short_j: f64,
}

impl<const N: usize> Tanks<N> {
    pub fn new(config: &TankConfig) -> Self {
        Self {
            motion: config.motion.start(),
            force: config.force.start(),
            under_way: [TorqueParts::zero(); DELAY_MAX + 1],
            last_q: None,
            work_j: 0.0,
            dissipated_j: 0.0,
            short_j: 0.0,
        }
    }

    /// Accounts for the period that ended at `q` (rad): the work of the torques in effect on the
    /// joints. `delay_periods` lie between a measurement and the torque computed from it.
    pub fn settle(&mut self, config: &TankConfig, q: &Joints<N>, delay_periods: usize) {
        let Some(last) = self.last_q.replace(*q) else {
            return;
        };
        let moved = q - last;
        let parts = self.under_way[delay_periods.min(DELAY_MAX)];
        let (by_motion, by_force, by_damping) = (
            parts.motion.dot(&moved),
            parts.force.dot(&moved),
            parts.damping.dot(&moved),
        );
        self.work_j += by_motion + by_force + by_damping;
        // A damper whose speed has reversed since it was computed drives the motion for a moment:
        // the motion tank supplies that too.
        let (pushed, damped) = (by_damping.max(0.0), (-by_damping).max(0.0));
        let drawn = config.motion.draw(&mut self.motion, by_motion + pushed);
        let pressed = config.force.draw(&mut self.force, by_force);
        // Energy that does not fit into one tank is offered to the other. Each joule is counted
        // once, and none is discarded unnecessarily.
        let to_force = config
            .force
            .fill(&mut self.force, damped * config.damping_share_to_force);
        let rest = damped * (1.0 - config.damping_share_to_force)
            + to_force.overflow_j
            + pressed.overflow_j;
        let to_motion = config.motion.fill(&mut self.motion, rest);
        self.dissipated_j += drawn.overflow_j + to_motion.overflow_j;
        // A deficit of one tank is settled after the period's own income is added, and from either
        // tank: both feed the same arm.
        let owed = config
            .force
            .draw(&mut self.force, drawn.short_j + pressed.short_j);
        self.short_j += config.motion.draw(&mut self.motion, owed.short_j).short_j;
    }

    /// Records the torques computed from the newest measurement.
    pub fn commit(&mut self, parts: TorqueParts<N>) {
        self.under_way.rotate_right(1);
        self.under_way[0] = parts;
    }

    /// The torques recorded last.
    pub fn committed(&self) -> TorqueParts<N> {
        self.under_way[0]
    }

    /// σ(S_t,i).
    pub fn motion_valve(&self, config: &TankConfig) -> f64 {
        config.motion.valve(&self.motion)
    }

    /// λ + σ(S_t,f) (1 - λ) of eq. (51) for a push (N) at a speed (m/s) along it. λ is 1 where it
    /// takes power out. The published switch is a step; this one is a ramp, on the side that does
    /// not affect passivity. With the valve shut, the ramp acts as a damper; its width makes that
    /// damper `switch_n_s_per_m` on average.
    pub fn force_share(&self, config: &TankConfig, push_n: f64, speed_m_per_s: f64) -> f64 {
        let width_w = (push_n * push_n / config.switch_n_s_per_m).max(1e-9);
        let lambda = smooth(-push_n * speed_m_per_s / width_w);
        lambda + config.force.valve(&self.force) * (1.0 - lambda)
    }

    pub fn books(&self) -> TankBooks {
        TankBooks {
            motion_j: self.motion.energy_j(),
            force_j: self.force.energy_j(),
            work_j: self.work_j,
            dissipated_j: self.dissipated_j,
            short_j: self.short_j,
        }
    }
}
