//! State of one task.

use nalgebra::{Vector3, Vector6};
use tangent_mechanics::Joints;

use super::Felt;

use super::super::config::UnifiedForceImpedanceConfig;
use super::super::energy::Tanks;
use super::super::fused_normal::FusedNormal;
use super::super::law::ForceLoop;
use super::super::monitor::Monitor;
use super::super::orientation::OrientationReference;
use crate::limits::arm_force::ArmForceGuard;
use crate::limits::motor_force::MotorForce;
use crate::limits::response_guard::ResponseGuard;
use crate::limits::wrench_guard::WrenchGuard;

/// Period assumed until the robot provides one, s.
const PERIOD_S: f64 = 0.001;

/// Placement of the policy: its origin and axes, base axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lay {
    pub origin: Vector3<f64>,
    pub x: Vector3<f64>,
    pub y: Vector3<f64>,
    /// Unit vector against the approach direction.
    pub up: Vector3<f64>,
}

/// State of one task.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run<const N: usize> {
    pub guard: WrenchGuard,
    pub response: ResponseGuard,
    pub arm_force: ArmForceGuard,
    pub motor_force: MotorForce<N>,
    /// Sum of the wrenches at rest, and the number of periods in it.
    pub zero: (Vector6<f64>, f64),
    /// Contact quantities of the last valid wrench.
    pub felt: Option<Felt>,
    /// When the zero was taken, s of the run; `None` before.
    pub zeroed_s: Option<f64>,
    /// Position at which the zero was taken, m; `None` after contact.
    pub tared_at: Option<Vector3<f64>>,
    /// The joints' friction as it appears in the robot's estimate, base axes.
    pub rubbing: Vector6<f64>,
    pub fused: FusedNormal,
    pub orientation: Option<OrientationReference>,
    pub monitor: Monitor,
    pub tanks: Tanks<N>,
    pub force: ForceLoop,
    /// Position that the tool holds while no motion is commanded, m.
    pub held: Option<Vector3<f64>>,
    /// Distance of the approach, m, and its speed, m/s.
    pub approach: (f64, f64),
    pub lay: Option<Lay>,
    pub path_s: f64,
    /// Rate of the policy's clock relative to real time, 0 to 1.
    pub rate: f64,
    /// Displacement of the policy while the arm was compliant, m.
    pub offset: Vector3<f64>,
    /// Last position at which the tool touched, m.
    pub last_contact: Vector3<f64>,
    pub last_velocity: Vector3<f64>,
    /// Acceleration of the policy, m/s².
    pub acceleration: Vector3<f64>,
    pub reference_n: f64,
    /// Last push of the force controller, N.
    pub push_n: f64,
    /// Last wrench asked of the tool, N and Nm, base axes; whether it was pressing; and the fading
    /// remainder of the mode before.
    pub last_wrench: Vector6<f64>,
    pub was_pressing: bool,
    pub bridge: Vector6<f64>,
    /// Integral of the path error, N.
    pub drawn: Vector3<f64>,
    pub surface_friction: f64,
    /// Time for which the force has been too low for contact, and high enough for a touch, s.
    pub weak_s: f64,
    pub strong_s: f64,
    pub lost_count: u32,
    pub sought_m: f64,
    pub blind_s: f64,
    /// Time with the motion tank's valve shut, s.
    pub empty_s: f64,
    pub torque: Option<Joints<N>>,
    /// Whether the torques of this period were not finite.
    pub lost: bool,
    /// Last valid period, s.
    pub period_s: f64,
    pub held_torque: Joints<N>,
    pub limited: bool,
}

impl<const N: usize> Run<N> {
    pub fn new(config: &UnifiedForceImpedanceConfig) -> Self {
        Self {
            guard: WrenchGuard::default(),
            response: ResponseGuard::default(),
            arm_force: ArmForceGuard::default(),
            motor_force: MotorForce::default(),
            zero: (Vector6::zeros(), 0.0),
            felt: None,
            zeroed_s: None,
            tared_at: None,
            rubbing: Vector6::zeros(),
            fused: FusedNormal::default(),
            orientation: None,
            monitor: Monitor::new(),
            tanks: Tanks::new(&config.tanks),
            force: ForceLoop::default(),
            held: None,
            approach: (0.0, 0.0),
            lay: None,
            path_s: 0.0,
            rate: 0.0,
            offset: Vector3::zeros(),
            last_contact: Vector3::zeros(),
            last_velocity: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            reference_n: 0.0,
            push_n: 0.0,
            last_wrench: Vector6::zeros(),
            was_pressing: false,
            bridge: Vector6::zeros(),
            drawn: Vector3::zeros(),
            surface_friction: 0.0,
            weak_s: 0.0,
            strong_s: 0.0,
            lost_count: 0,
            sought_m: 0.0,
            blind_s: 0.0,
            empty_s: 0.0,
            torque: None,
            lost: false,
            period_s: PERIOD_S,
            held_torque: Joints::zeros(),
            limited: false,
        }
    }
}
