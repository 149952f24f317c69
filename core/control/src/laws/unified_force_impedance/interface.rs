//! Inputs and outputs of `unified_force_impedance`, once per control period.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Base, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use crate::inputs::UntaredLoad;
pub use crate::inputs::{BendChange, VisionInput};
use crate::leaving::clearance::Clearance;
use crate::limits::faults::Fault;
use crate::phase_machine::Phase;

/// Interface between the law's torques and the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueInterface {
    /// Periods between a measurement and the torque computed from it. The tanks account for the
    /// torques in effect, and the damping is limited to what is stable with this delay.
    pub delay_periods: usize,
    /// Whether the arm itself compensates gravity: commands then exclude it.
    pub gravity_by_arm: bool,
    /// Share of the joints' torque limits that a command may use.
    pub effort_share: f64,
    /// Share of the motors' rate limits that a command may use.
    pub rate_share: f64,
}

impl Default for TorqueInterface {
    /// An arm that applies the full torques at once.
    fn default() -> Self {
        Self {
            delay_periods: 0,
            gravity_by_arm: false,
            effort_share: 1.0,
            rate_share: 1.0,
        }
    }
}

/// Inputs of one period. The wrench is that of the environment on the tool.
#[derive(Clone, Copy, Debug)]
pub struct UnifiedInput<const N: usize = 7> {
    /// Time of this period, s, on any clock that does not jump.
    pub time_s: f64,
    /// Nominal period, s.
    pub dt_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<N>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// The robot's own estimate of the external wrench: joint friction is in it.
    pub wrench: Wrench<Tool>,
    /// Whether the wrench can be used.
    pub wrench_validity: Validity,
    /// Age of the wrench, s.
    pub wrench_age_s: f64,
    /// Reading before the bridge subtracts any zero; `None` if the bridge does not provide it.
    pub untared: Option<UntaredLoad>,
    /// Newest normal from the camera, if there is one.
    pub vision: Option<VisionInput>,
    /// Newest normal from touch, made from [`UnifiedOutput::wrench`].
    pub touch: Option<NormalEstimate>,
    /// Age of the newest normal from touch, s.
    pub touch_age_s: f64,
}

/// Energy accounts of the law since the task started, J. Used by `energy`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TankBooks {
    /// Energy in the motion tank, S_t,i.
    pub motion_j: f64,
    /// Energy in the force tank, S_t,f.
    pub force_j: f64,
    /// Work of all torques but [`UnifiedOutput::held_torque`], from the measured joint positions.
    pub work_j: f64,
    /// Energy that damping dissipated and no tank could hold.
    pub dissipated_j: f64,
    /// Deficit of the tanks at their lower limits. Zero: the valves closed in time.
    pub short_j: f64,
}

/// Command of one period, and the quantities behind it.
#[derive(Clone, Copy, Debug)]
pub struct UnifiedOutput<const N: usize = 7> {
    /// Torques to command, Nm, within the limits of the interface; they include gravity unless the
    /// arm compensates it.
    pub torque: Joints<N>,
    /// Part of the torques that depends on the joints' positions alone, Nm: gravity compensation,
    /// and the springs at the joints' end stops.
    pub held_torque: Joints<N>,
    /// Phase after this period.
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// Whether the force shows that the tool touches.
    pub in_contact: bool,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Its covariance, base axes, rad².
    pub normal_covariance: Matrix3<f64>,
    /// Whether the normal is measured now.
    pub normal_validity: Validity,
    /// Wrench in use: without the zero, and without the joints' friction if that is compensated.
    /// `None` if none can be used.
    pub wrench: Option<Wrench<Tool>>,
    /// Desired pressing force, shaped by ρ_frc, N.
    pub force_reference_n: f64,
    /// Pressing force measured along the tool's axis, N; `None` if no wrench can be used.
    pub force_n: Option<f64>,
    /// Whether the tool may touch something. The next start depends on it.
    pub clearance: Clearance,
    /// Age of the zero that the law has taken, s; `None` before.
    pub zero_age_s: Option<f64>,
    /// Bound on the error of the zero, by its age, N.
    pub zero_bound_n: Option<f64>,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Reference position of the tool's origin, base axes, m. Its height is only that of the
    /// surface at the last update.
    pub path_reference: Vector3<f64>,
    /// Distance of the tool's origin from the reference across the normal, m.
    pub path_error_m: f64,
    /// Progress along the path, 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// Contact-alignment monitor C, eq. (17).
    pub monitor: f64,
    /// Margin C_m of the monitor in use.
    pub monitor_margin: f64,
    /// ρ_align, eq. (20).
    pub rho_align: f64,
    /// ρ_frc, eq. (30).
    pub rho_force: f64,
    /// Energy accounts of the tanks.
    pub tanks: TankBooks,
    /// Friction coefficient in use between tool and surface.
    pub friction: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Whether a torque, rate or joint limit cut the command.
    pub limited: bool,
}
