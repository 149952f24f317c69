//! Inputs and outputs of `unified_force_impedance`, once per control period.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Base, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use crate::law::UntaredLoad;
use crate::leaving::clearance::Clearance;
use crate::limits::faults::Fault;
use crate::phase_machine::Phase;

/// Number of joints of the arm.
pub const JOINTS: usize = 7;

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

/// Camera's estimate of the surface at the tool.
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
    /// Surface variation λ₃ / tr Σ of the segment, eq. (16); the paper's l_s. `None` if the segment
    /// was lost or never cut out: the flatness of the surface is then unknown.
    pub surface_variation: Option<f64>,
    /// Shape operator at the point: moving by `dp` turns the normal by `curvature * dp`. Base axes,
    /// 1/m; `None` if not known.
    pub curvature: Option<Matrix3<f64>>,
    /// Change of the curvature ahead of the tool, from the map; `None` if the tool stands or
    /// nothing is seen there.
    pub change: Option<BendChange>,
    /// Whether the estimate can be used.
    pub validity: Validity,
}

/// Change of the curvature along a direction: a linear model of the surface ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BendChange {
    /// Direction of motion, unit, base axes.
    pub way: Vector3<f64>,
    /// Change of the curvature per metre along that direction, 1/m².
    pub per_m2: f64,
}

/// Distance ahead over which the change of curvature is estimated, m.
const CHANGE_REACH_M: f64 = 0.04;
/// Largest change of curvature of a surface that a tool of this size can wipe, 1/m².
const CHANGE_MAX_PER_M2: f64 = 1000.0;

impl BendChange {
    /// Least-squares line through the curvatures (1/m) of a map's stations, each with its distance
    /// (m) and standard deviation (1/m); `way` points from the first to the second. `None` for
    /// fewer than three stations.
    pub fn of(way: &Vector3<f64>, stations: impl Iterator<Item = (f64, f64, f64)>) -> Option<Self> {
        let way = way.try_normalize(1e-9)?;
        let mut n = 0;
        let (mut w, mut wx, mut wy, mut wxx, mut wxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (x, y, sd) in stations.take_while(|(x, ..)| *x <= CHANGE_REACH_M) {
            let weight = 1.0 / (sd * sd).max(1e-6);
            n += 1;
            w += weight;
            wx += weight * x;
            wy += weight * y;
            wxx += weight * x * x;
            wxy += weight * x * y;
        }
        let spread = w * wxx - wx * wx;
        let per_m2 = (w * wxy - wx * wy) / spread;
        let found = Self { way, per_m2 };
        (n >= 3 && spread > 0.0 && found.is_sound()).then_some(found)
    }

    /// Shape operator after the displacement `moved`, m.
    pub fn after(&self, curvature: &Matrix3<f64>, moved: &Vector3<f64>) -> Matrix3<f64> {
        let on = moved.dot(&self.way);
        curvature + self.way * self.way.transpose() * (self.per_m2 * on)
    }

    /// Interpolates towards `new` by `share`.
    pub(super) fn towards(&self, new: &Self, share: f64) -> Self {
        // In another direction the tool meets a different part of the surface.
        if self.way.dot(&new.way) < 0.9 {
            return *new;
        }
        Self {
            way: new.way,
            per_m2: self.per_m2 + (new.per_m2 - self.per_m2) * share,
        }
    }

    pub(super) fn is_sound(&self) -> bool {
        self.per_m2.abs() <= CHANGE_MAX_PER_M2 && (self.way.norm() - 1.0).abs() < 1e-6
    }
}

/// Inputs of one period. The wrench is that of the environment on the tool.
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
pub struct UnifiedOutput {
    /// Torques to command, Nm, within the limits of the interface; they include gravity unless the
    /// arm compensates it.
    pub torque: Joints<JOINTS>,
    /// Part of the torques that depends on the joints' positions alone, Nm: gravity compensation,
    /// and the springs at the joints' end stops.
    pub held_torque: Joints<JOINTS>,
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
