//! Parameters of `unified_force_impedance`, with the presets `paper` (Table I) and `default`.

mod presets;
mod ranges;

use serde::{Deserialize, Serialize};

use crate::contact::energy_tank::EnergyTank;
use crate::leaving::config::LeaveConfig;
use crate::parameters::{FrictionConfig, PathProfileConfig, PatienceConfig};

/// All parameters of the law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnifiedForceImpedanceConfig {
    /// Impedance of the tool, eqs. (7)-(9).
    pub impedance: ImpedanceConfig,
    /// Force controller, eqs. (10)-(12).
    pub force: ForceLoopConfig,
    /// Contact-alignment monitor, eqs. (17)-(21).
    pub monitor: MonitorConfig,
    /// Desired orientation of the tool, eqs. (22)-(29).
    pub orientation: OrientationConfig,
    /// Force shaping, eqs. (30)-(31).
    pub shaping: ShapingConfig,
    /// Energy tanks, eqs. (34)-(73).
    pub tanks: TankConfig,
    /// Fusion of vision and touch into one normal.
    pub fusion: FusionConfig,
    /// Known friction of the joints.
    pub friction: FrictionConfig,
    /// Whether the law compensates this friction, in the torques and in the wrench; the published
    /// law does neither.
    pub compensate_friction: bool,
    /// Posture of the redundant joint.
    pub posture: PostureConfig,
    /// Detection of contact and of its loss.
    pub touch: TactileTouchConfig,
    /// Acceleration, jerk and clock of the path; its gains are not used.
    pub path: PathProfileConfig,
    /// Timeouts of missing and of invalid input.
    pub patience: PatienceConfig,
    /// How the tool leaves a surface, and how it is shown to be free.
    pub leave: LeaveConfig,
}

/// Stiffness and damping of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImpedanceConfig {
    /// K_max of translations along the tool's axes while pressing, N/m.
    pub stiffness_n_per_m: [f64; 3],
    /// K_max of rotations about the tool's axes while pressing, Nm/rad.
    pub stiffness_nm_per_rad: [f64; 3],
    /// Damping ratios, translations then turns: `D = 2 ζ sqrt(K m)` with the arm's own inertia
    /// along each axis.
    pub damping_ratio: [f64; 6],
    /// Additional damping along the tool's axis while pressing, Ns/m.
    pub normal_damping_n_s_per_m: f64,
    /// Stiffness of all translations while the tool is moved without pressing, N/m.
    pub free_stiffness_n_per_m: f64,
    /// Whether the reference's velocity and acceleration and the friction on the surface are fed
    /// forward.
    pub feed_forward: bool,
    /// Integral of the path error across the normal, 1/s, relative to the stiffness; 0: none, as
    /// published.
    pub integral_per_s: f64,
    /// Bound of that integral, N.
    pub integral_max_n: f64,
}

/// PI control of the force along the tool's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceLoopConfig {
    /// K_p.
    pub proportional: f64,
    /// K_i, 1/s.
    pub integral_per_s: f64,
    /// Bound of the integral, N.
    pub integral_max_n: f64,
    /// Low-pass on the error that K_p sees, s.
    pub filter_s: f64,
    /// Whether the force is controlled along the normal in use; if not, along the tool's axis, as
    /// published.
    pub along_normal: bool,
    /// How fast the reference rises from the force at touchdown, N/s.
    pub reference_rate_n_per_s: f64,
}

/// Contact-alignment monitor and stiffness shaping.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MonitorConfig {
    /// α, 1/J.
    pub alpha_per_j: f64,
    /// ξ, 1/deg: with θ in radians, the published 0.08 would make θ's effect negligible.
    pub xi_per_deg: f64,
    /// γ.
    pub gamma: f64,
    /// C_m; if it is estimated online, its initial value.
    pub margin: f64,
    /// Online estimate of C_m: the monitor's mean during undisturbed operation plus this many
    /// standard deviations; 0: C_m stays constant.
    pub margin_sd: f64,
    /// Time constant of that mean, s.
    pub margin_time_s: f64,
    /// Lower and upper bound of the estimated C_m.
    pub margin_range: [f64; 2],
    /// ρ_min, 1/s.
    pub rho_min_per_s: f64,
    /// Rate of ρ_align, 1/s: 1 as published.
    pub rate_per_s: f64,
}

/// How the tool's orientation follows the normal in use.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OrientationConfig {
    /// T of eqs. (28)-(29), s: duration of the turn to each new normal. If the motion of the normal
    /// is fed forward, the time constant for the remaining error.
    pub follow_s: f64,
    /// Maximum turn rate of the reference, rad/s.
    pub turn_rate_max_rad_per_s: f64,
    /// Maximum turn acceleration of the reference, rad/s²: bounds what the dampers must do if the
    /// normal jumps.
    pub turn_acceleration_max_rad_per_s2: f64,
    /// Whether the surface's rotation under the tool is fed forward from the curvature seen ahead.
    pub feed_forward: bool,
}

/// Force shaping.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShapingConfig {
    /// δ_c, m.
    pub margin_m: f64,
    /// Whether x̃_z counts from the tool's last contact instead of the height at which the policy
    /// was placed: a tool that follows a falling surface has not lost it.
    pub from_last_contact: bool,
}

/// The motion tank and the force tank.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TankConfig {
    /// Motion tank S_t,i.
    pub motion: EnergyTank,
    /// Force tank S_t,f.
    pub force: EnergyTank,
    /// Share of the dissipated damping energy that is offered to the force tank; the rest is
    /// offered to the motion tank.
    pub damping_share_to_force: f64,
    /// λ of eq. (38) changes between its values over the speed at which a damper of this size takes
    /// the whole push, Ns/m. With the force tank's valve shut, the transition acts as such a
    /// damper.
    pub switch_n_s_per_m: f64,
    /// Upper limit of the power of the motion tank's torques, W.
    pub power_max_w: f64,
}

/// Fusion of vision and touch into one normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FusionConfig {
    /// Whether touch is used; if not, the camera alone, as published.
    pub touch: bool,
    /// Whether a frame is carried along by its curvature, filtered, with growing uncertainty; if
    /// not, it stays unchanged until the next, as published.
    pub carry: bool,
    /// Systematic error of the camera that averaging over frames cannot remove (its mounting), rad.
    pub vision_floor_rad: f64,
    /// Standard deviation about each axis of the tilt of the camera's mounting, rad. It is learnt
    /// while the tool slides; 0: not at all.
    pub mounting_sd_rad: f64,
    /// Lower bound of the standard deviation of touch, rad.
    pub touch_floor_rad: f64,
    /// Standard deviation of the measured curvature, 1/m.
    pub curvature_sd_per_m: f64,
    /// Gate for outliers among the frames, in standard deviations; never less than 0.1 rad.
    pub gate_sd: f64,
    /// Number of consecutive, consistent outliers after which they are accepted.
    pub gate_frames: u32,
    /// Age of the newest frame beyond which the camera's estimate is no longer used, s.
    pub vision_patience_s: f64,
}

/// Posture of the redundant joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PostureConfig {
    /// Stiffness towards the middle of the joints' ranges, steeper near their ends, Nm/rad; 0:
    /// none, as published.
    pub stiffness_nm_per_rad: f64,
    /// Damping of the null-space motion, Nm s/rad.
    pub damping_nm_s_per_rad: f64,
}

/// Detection of contact and of its loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TactileTouchConfig {
    /// Force above which contact is detected, N.
    pub on_n: f64,
    /// Force below which contact is no longer detected, N.
    pub off_n: f64,
    /// Time below `off_n` after which contact counts as lost, s.
    pub lost_s: f64,
    /// Time below `off_n` after which the policy stops, s.
    pub pause_s: f64,
    /// Number of losses after which the task ends.
    pub lost_count_max: u32,
    /// Whether a lost surface is sought with the policy's clock stopped; if not, the force
    /// controller alone brings the tool back, as published.
    pub seek: bool,
    /// Speed towards a lost surface, m/s.
    pub seek_speed_m_per_s: f64,
    /// Angle to the measured normal within which the approach begins, rad.
    pub aligned_rad: f64,
    /// Maximum time to reach this angle, s.
    pub align_s: f64,
    /// Time at rest over which the wrench's zero is averaged, s.
    pub tare_s: f64,
    /// Largest plausible zero, N: a larger one means that the tool touches something or that the
    /// payload set in the robot is wrong.
    pub zero_max_n: f64,
    /// Drift of the zero, N per minute: bounds the error of a zero by its age.
    pub zero_drift_n_per_min: f64,
    /// Minimum time between touchdown and path, s.
    pub settle_s: f64,
    /// Lag of the robot's wrench estimate, s: the friction that is subtracted from it is delayed by
    /// the same.
    pub wrench_lag_s: f64,
}
