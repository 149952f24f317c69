//! What `unified_force_impedance` takes and gives, once per control period.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Base, Joints, Pose, Tool, Wrench};
use tangent_sensing::Validity;

use crate::{Clearance, Fault, Phase, UntaredLoad};

/// Joints of the arm.
pub const JOINTS: usize = 7;

/// What stands between the law's torques and the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueInterface {
    /// Periods between a measurement and the torque that answers it. The tanks account for the
    /// torques in force, and no damper is stronger than this delay bears.
    pub delay_periods: usize,
    /// The arm adds what holds it against gravity itself: commands are without it.
    pub gravity_by_arm: bool,
    /// Share of the joints' efforts that a command may ask for.
    pub effort_share: f64,
    /// Share of the rate that the motors bear.
    pub rate_share: f64,
}

impl Default for TorqueInterface {
    /// An arm that takes torques as they are, at once.
    fn default() -> Self {
        Self {
            delay_periods: 0,
            gravity_by_arm: false,
            effort_share: 1.0,
            rate_share: 1.0,
        }
    }
}

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
    /// Surface variation λ₃ / tr Σ of the segment, eq. (16); the paper's l_s. None where the
    /// segment was lost or never cut out: that says nothing of how flat the surface is.
    pub surface_variation: Option<f64>,
    /// Shape operator there: moving by `dp` turns the normal by `curvature * dp`. Base axes, 1/m;
    /// none where it is not known.
    pub curvature: Option<Matrix3<f64>>,
    /// How the surface bends on where the tool goes, from the map ahead; none where it stands or
    /// nothing is seen there.
    pub change: Option<BendChange>,
    /// Whether to use it.
    pub validity: Validity,
}

/// Change of the bend along a way: what comes, as far as it is a straight line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BendChange {
    /// Where it goes on, unit, base axes.
    pub way: Vector3<f64>,
    /// The bend along the way changes by this per metre, 1/m².
    pub per_m2: f64,
}

/// Way ahead over which the bend's change is taken, m.
const CHANGE_REACH_M: f64 = 0.04;
/// No surface that a tool of this size can wipe bends on faster, 1/m².
const CHANGE_MAX_PER_M2: f64 = 1000.0;

impl BendChange {
    /// The line through the bends (1/m) of a map's stations, each with its distance (m) and
    /// standard deviation (1/m), by least squares; `way` from the first to the second. None of
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

    /// Shape operator `moved` further on.
    pub fn after(&self, curvature: &Matrix3<f64>, moved: &Vector3<f64>) -> Matrix3<f64> {
        let on = moved.dot(&self.way);
        curvature + self.way * self.way.transpose() * (self.per_m2 * on)
    }

    /// A share of the way to `new`.
    pub(super) fn towards(&self, new: &Self, share: f64) -> Self {
        // A tool that goes elsewhere looks at another surface.
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
    /// The reading before the bridge took any zero off; none where it does not tell.
    pub untared: Option<UntaredLoad>,
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
    /// Torques to command, Nm, within what the interface takes; gravity is in them unless the arm
    /// adds it.
    pub torque: Joints<JOINTS>,
    /// The part of them that depends on the joints' positions alone, Nm: against gravity, and the
    /// springs before the joints' ends.
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
    /// None where none can be used.
    pub wrench: Option<Wrench<Tool>>,
    /// Pressing force asked for, shaped by ρ_frc, N.
    pub force_reference_n: f64,
    /// Pressing force measured along the tool's axis, N; none where no wrench can be used.
    pub force_n: Option<f64>,
    /// Whether the tool may touch something. The next start goes by it.
    pub clearance: Clearance,
    /// Age of the zero that the law has taken, s; none while there is none.
    pub zero_age_s: Option<f64>,
    /// Error of the zero that this age implies, N.
    pub zero_bound_n: Option<f64>,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Where the policy wants the tool's origin, base axes, m. Its height is only what the tool met
    /// at the last look.
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
