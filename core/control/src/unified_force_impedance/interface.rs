//! What `unified_force_impedance` takes and gives, once per control period.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Base, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use crate::{Fault, Phase};

/// Joints of the arm.
pub const JOINTS: usize = 7;

/// What a camera says about the surface at the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionInput {
    /// Time of exposure, s, on the clock of [`UnifiedInput::time_s`].
    pub time_s: f64,
    /// Point of the surface that the normal belongs to, base axes, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Covariance of the normal, base axes, rad².
    pub covariance: Matrix3<f64>,
    /// Surface variation λ₃ / tr Σ of the segment, eq. (16); the paper's l_s.
    pub surface_variation: f64,
    /// Shape operator there: moving by `dp` turns the normal by `curvature * dp`. Base axes, 1/m; none where it is not known.
    pub curvature: Option<Matrix3<f64>>,
    /// Whether to use it.
    pub validity: Validity,
}

/// One period as the law sees it. The wrench is what the environment does to the tool.
#[derive(Clone, Copy, Debug)]
pub struct UnifiedInput {
    /// Time of this period, s, on any clock that does not jump.
    pub time_s: f64,
    /// Nominal period, s.
    pub dt_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<JOINTS>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<JOINTS>,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// The robot's own estimate of the external wrench: joint friction is in it.
    pub wrench: Wrench<Tool>,
    /// Whether to use it.
    pub wrench_validity: Validity,
    /// How old it is now, s.
    pub wrench_age_s: f64,
    /// Newest normal from the camera, as long as there is one.
    pub vision: Option<VisionInput>,
    /// Newest normal from touch, made from [`UnifiedOutput::wrench`].
    pub touch: Option<NormalEstimate>,
    /// How old that is now, s.
    pub touch_age_s: f64,
}

/// Energy that the law accounts for, J: its books since the task started. See `energy`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TankBooks {
    /// In the motion tank, S_t,i.
    pub motion_j: f64,
    /// In the force tank, S_t,f.
    pub force_j: f64,
    /// Work of all torques but [`UnifiedOutput::held_torque`], by the measured joints.
    pub work_j: f64,
    /// Dissipated: what damping took and no tank could hold.
    pub dissipated_j: f64,
    /// What a tank was short of at its lower limit. Zero: the valves closed in time.
    pub short_j: f64,
}

/// One period's command and what it was made of.
#[derive(Clone, Copy, Debug)]
pub struct UnifiedOutput {
    /// Motor torques, Nm, within the arm's limits and gravity included.
    pub torque: Joints<JOINTS>,
    /// The part of them that depends on the joints' positions alone, Nm: against gravity, and the springs before the joints' ends.
    pub held_torque: Joints<JOINTS>,
    /// Phase after this period.
    pub phase: Phase,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
    /// The tool touches, by the force.
    pub in_contact: bool,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Its covariance, base axes, rad².
    pub normal_covariance: Matrix3<f64>,
    /// Whether it comes from what is seen or felt now.
    pub normal_validity: Validity,
    /// Wrench in use: without the zero, and without the joints' friction where that is made up for.
    pub wrench: Wrench<Tool>,
    /// Pressing force asked for, shaped by ρ_frc, N.
    pub force_reference_n: f64,
    /// Pressing force measured along the tool's axis, N.
    pub force_n: f64,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Where the policy wants the tool's origin, base axes, m. Its height is only what the tool met at the last look.
    pub path_reference: Vector3<f64>,
    /// Distance from it across the normal, m.
    pub path_error_m: f64,
    /// 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// Contact-alignment monitor C, eq. (17).
    pub monitor: f64,
    /// Its margin C_m in use.
    pub monitor_margin: f64,
    /// ρ_align, eq. (20).
    pub rho_align: f64,
    /// ρ_frc, eq. (30).
    pub rho_force: f64,
    /// Tanks and what they account for.
    pub tanks: TankBooks,
    /// Friction coefficient between tool and surface in use.
    pub friction: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// A torque, rate or joint limit cut the command.
    pub limited: bool,
}
