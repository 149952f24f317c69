//! The force-controlled half of the hybrid law: eq. (1) along the normal and about the tangential
//! axes, with damping for the measured stiffness, an integral for the surface's motion, and a ramp
//! on the reference.
//!
//! Called by the controller each cycle while the tool presses.

mod settling;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tangent_mechanics::{Aligned, Base, Contact, Pose, Tool, Twist, Wrench};

use self::settling::Settling;
use super::admittance::{Admittance, AdmittanceState};
use super::config::ControllerConfig;
use super::delay_in_use::{delay_longest_s, delay_shortest_s};
use super::force_integral::ForceIntegral;
use super::recoil::Recoil;
use super::ringing::Ringing;
use super::stiffness::Stiffness;
use crate::contact::alignment::{any_perpendicular, tangential};
use crate::contact::energy_tank::{EnergyTank, EnergyTankState};
use crate::limits::{Limits, clamp_norm};

/// Factor by which the contact is taken to be stiffer when the loop rings.
const RINGING_FACTOR: f64 = 1.5;
/// Share of the stiffest contact expected that the stiffness is not lowered below while the tool's
/// turns have a large part in the depth.
const TURNED_LEAST_SHARE: f64 = 0.4;

/// Inputs of the force law in one cycle.
#[derive(Clone, Copy, Debug)]
pub struct ForceSample {
    /// Measured at the tool's origin, base axes.
    pub wrench: Wrench<Aligned<Tool, Base>>,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Where the force acts, relative to the tool's origin, tool axes, m.
    pub acting_in_tool_m: Vector3<f64>,
    /// Normal in use, base axes.
    pub normal: Vector3<f64>,
    /// Commanded sliding velocity, base axes, m/s.
    pub along: Vector3<f64>,
    /// Velocity along the normal that is fed forward, out of the material, m/s; `None` without a
    /// memory of the surface.
    pub ahead_m_per_s: Option<f64>,
    /// Delay of the wrench's filter, s.
    pub wrench_delay_s: f64,
    /// Whether the tool stands on the surface while the force builds up: depth and force then show
    /// the stiffness.
    pub settling: bool,
    /// Period, s.
    pub dt_s: f64,
}

/// The force law and its state.
#[derive(Clone, Copy, Debug)]
pub struct ForceLaw {
    state: AdmittanceState,
    integral: ForceIntegral,
    stiffness: Stiffness,
    reference_n: f64,
    recoil: Recoil,
    ringing: Ringing,
    damping: f64,
    settling: Settling,
    /// Least stiffness that is learnt while the tool turns, N/m.
    turned_least_n_per_m: f64,
    /// Energy that may still be put into the surface, if the configuration bounds it.
    tank: Option<EnergyTankState>,
    /// Position of the tool at the last energy accounting; `None` after a time in which the law did
    /// not press.
    settled_at: Option<Vector3<f64>>,
}

impl ForceLaw {
    /// At rest, with nothing learnt; `stiffness_n_per_m` is the expected value.
    pub fn new(stiffness_n_per_m: f64) -> Self {
        Self {
            state: AdmittanceState::default(),
            integral: ForceIntegral::default(),
            stiffness: Stiffness::new(stiffness_n_per_m),
            reference_n: 0.0,
            recoil: Recoil::default(),
            ringing: Ringing::default(),
            damping: 0.0,
            settling: Settling::default(),
            turned_least_n_per_m: TURNED_LEAST_SHARE * stiffness_n_per_m,
            tank: None,
            settled_at: None,
        }
    }

    /// Energy that may still be put into the surface, J; `None` if it is not bounded.
    pub fn tank_j(&self) -> Option<f64> {
        self.tank.map(|tank| tank.energy_j())
    }

    /// Accounts for the work that the tool did on the surface since the last cycle, from its
    /// measured motion. Returns the share of an inward speed that the tank allows now.
    fn allowed(&mut self, tank: &EnergyTank, sample: &ForceSample, force_n: f64) -> f64 {
        let at = sample.base_from_tool.translation();
        let mut state = self.tank.unwrap_or_else(|| tank.start());
        let before = self.settled_at.replace(at).unwrap_or(at);
        let inward_m = (before - at).dot(&sample.normal);
        tank.draw(&mut state, force_n.max(0.0) * inward_m);
        self.tank = Some(state);
        tank.valve(&state)
    }

    /// Starts at a touch with `force_n` (N), at the approach speed `speed_m_per_s`.
    pub fn touch(&mut self, config: &ControllerConfig, force_n: f64, speed_m_per_s: f64) {
        let mut twist = Twist::zero();
        twist.linear.z = -speed_m_per_s;
        self.state = AdmittanceState { twist };
        self.integral.reset();
        self.stiffness.restart();
        self.settling = Settling::default();
        self.settled_at = None;
        self.reference_n = force_n;
        self.recoil = if config.force.adaptive {
            let (shortest_s, longest_s) = (
                delay_shortest_s(&config.force),
                delay_longest_s(&config.force),
            );
            Recoil::new(force_n, speed_m_per_s, shortest_s, longest_s)
        } else {
            Recoil::default()
        };
    }

    /// Stiffness in use, N/m.
    pub fn stiffness_n_per_m(&self) -> f64 {
        self.stiffness.value_n_per_m()
    }

    /// Measured stiffness of the contact, N/m; `None` before a measurement.
    pub fn stiffness_measured_n_per_m(&self) -> Option<f64> {
        self.stiffness
            .is_known()
            .then(|| self.stiffness.value_n_per_m())
    }

    /// Whether the stiffness in use follows from a measurement in this contact.
    pub fn stiffness_is_settled(&self) -> bool {
        self.stiffness.is_settled()
    }

    /// Damping in use, Ns/m.
    pub fn damping_n_s_per_m(&self) -> f64 {
        self.damping
    }

    /// Reference in effect, N: ramps to the one requested.
    pub fn reference_n(&self) -> f64 {
        self.reference_n
    }

    /// Resets the velocity state: the tool stands still for another reason.
    pub fn rest(&mut self) {
        self.state = AdmittanceState::default();
        self.settled_at = None;
    }

    /// Processes one cycle towards `reference_n` (N). Returns the velocity along the normal (out of
    /// the material, m/s) and the turn rate from the torque (base axes, rad/s).
    pub fn step(
        &mut self,
        config: &ControllerConfig,
        limits: &Limits,
        reference_n: f64,
        sample: &ForceSample,
    ) -> (f64, Vector3<f64>) {
        let (force, dt) = (&config.force, sample.dt_s);
        let force_n = sample.wrench.force.dot(&sample.normal);
        if force.adaptive && sample.settling {
            self.settling.add(
                &sample.base_from_tool,
                &sample.acting_in_tool_m,
                &sample.normal,
                dt,
            );
            let least_n_per_m = if self.settling.is_turned() {
                self.turned_least_n_per_m
            } else {
                0.0
            };
            let delay_s = sample.wrench_delay_s;
            self.stiffness
                .update(self.settling.depth_m(), force_n, least_n_per_m, delay_s, dt);
        }
        if force.adaptive && self.recoil.is_over() {
            let error_n = force_n - self.reference_n;
            let delay_s = delay_longest_s(force);
            if self.ringing.step(error_n, reference_n, delay_s, dt) {
                self.stiffness.stiffen(RINGING_FACTOR);
            }
        }
        self.damping = if force.adaptive {
            (self.stiffness.value_n_per_m() * delay_longest_s(force) / force.delay_margin_rad)
                .clamp(force.damping_n_s_per_m, force.damping_max_n_s_per_m)
        } else {
            force.damping_n_s_per_m
        };
        let recoil = self.recoil.step(force_n, dt);
        let waiting = recoil.is_some();
        if waiting {
            self.reference_n = force_n.clamp(0.0, reference_n.max(0.0));
        } else {
            let step = force.reference_rate_n_per_s * dt;
            self.reference_n += (reference_n - self.reference_n).clamp(-step, step);
        }
        let base_from_contact = contact_axes(&sample.normal, &sample.base_from_tool);
        let measured = sample.wrench;
        // Measured minus reference; `admittance` explains the sign. While waiting, the force has no
        // effect.
        let error_n = if waiting {
            0.0
        } else {
            force_n - self.reference_n
        };
        let torque = base_from_contact.inverse_transform_vector(&measured.torque);
        let error = Wrench::<Contact>::new(
            Vector3::new(0.0, 0.0, error_n),
            Vector3::new(torque.x, torque.y, 0.0),
        );
        let law = Admittance::force_along_normal(
            force.mass_kg,
            config.torque.inertia_kg_m2,
            self.damping,
            config.torque.damping_n_m_s_per_rad,
        );
        let twist = law.step(&mut self.state, &error, dt);
        let mut speed = match recoil {
            Some(back) if back > 0.0 => back,
            _ => twist.linear.z,
        };
        if force.integral_ratio > 0.0 {
            if !waiting {
                // The crossover follows from stiffness and damping in use.
                let crossover = (self.stiffness.value_n_per_m() / self.damping)
                    .min(force.delay_margin_rad / delay_longest_s(force));
                let rate = error_n / self.damping * crossover / force.integral_ratio;
                self.integral.step(
                    rate,
                    &tangential(&sample.along, &sample.normal),
                    &sample.normal,
                    force.integral_speed_max_m_per_s,
                    dt,
                );
            }
            speed += self.integral.velocity(&sample.along);
        }
        if let Some(ahead) = sample.ahead_m_per_s {
            speed += ahead;
        }
        speed = speed.clamp(-force.speed_max_m_per_s, force.speed_max_m_per_s);
        if force_n > 0.0 {
            speed = speed.max(-limits.power_max_w / force_n);
        }
        if let Some(tank) = &force.tank {
            let share = self.allowed(tank, sample, force_n);
            if speed < 0.0 {
                speed *= share;
            }
        }
        let turn = clamp_norm(
            base_from_contact * twist.angular,
            config.torque.turn_rate_max_rad_per_s,
        );
        (speed, turn)
    }
}

/// Axes of the contact: z along the normal, x as near to the tool's x as the surface allows.
fn contact_axes(normal: &Vector3<f64>, base_from_tool: &Pose<Base, Tool>) -> UnitQuaternion<f64> {
    let x = tangential(&base_from_tool.rotate(&Vector3::x()), normal);
    let x = if x.norm() > 1e-6 {
        x.normalize()
    } else {
        any_perpendicular(normal)
    };
    let y = normal.cross(&x);
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, *normal]));
    UnitQuaternion::from_rotation_matrix(&axes)
}

#[cfg(test)]
mod tests;
