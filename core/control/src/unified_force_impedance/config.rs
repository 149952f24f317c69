//! Parameters of `unified_force_impedance`, with the presets `paper` (Table I) and `default`.

mod ranges;

use serde::{Deserialize, Serialize};

use crate::config::{PatienceConfig, with_changes};
use crate::energy_tank::EnergyTank;
use crate::{ControlError, FrictionConfig, LeaveConfig, PathProfileConfig};

/// All parameters of the law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnifiedForceImpedanceConfig {
    /// Eqs. (7)-(9).
    pub impedance: ImpedanceConfig,
    /// Eqs. (10)-(12).
    pub force: ForceLoopConfig,
    /// Eqs. (17)-(21).
    pub monitor: MonitorConfig,
    /// Eqs. (22)-(29).
    pub orientation: OrientationConfig,
    /// Eqs. (30)-(31).
    pub shaping: ShapingConfig,
    /// Eqs. (34)-(73).
    pub tanks: TankConfig,
    /// Vision and touch into one normal.
    pub fusion: FusionConfig,
    /// What is known of the joints' friction.
    pub friction: FrictionConfig,
    /// It is made up for, in the torques and in the wrench; the published law does neither.
    pub compensate_friction: bool,
    /// Where the arm's spare joint goes.
    pub posture: PostureConfig,
    /// Meeting and losing the surface.
    pub touch: TactileTouchConfig,
    /// Acceleration, jerk and clock of the path; its gains are not used.
    pub path: PathProfileConfig,
    /// How long to wait for whom.
    pub patience: PatienceConfig,
    /// How the tool leaves a surface, and what shows that it did.
    pub leave: LeaveConfig,
}

/// Stiffness and damping of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImpedanceConfig {
    /// K_max of translations along the tool's axes while pressing, N/m.
    pub stiffness_n_per_m: [f64; 3],
    /// Of turns about them, Nm/rad.
    pub stiffness_nm_per_rad: [f64; 3],
    /// Damping ratios, translations then turns: `D = 2 ζ sqrt(K m)` with the arm's own inertia
    /// along each axis.
    pub damping_ratio: [f64; 6],
    /// Damping along the tool's axis on top of that while pressing, Ns/m.
    pub normal_damping_n_s_per_m: f64,
    /// Stiffness of all translations while the tool is moved without pressing, N/m.
    pub free_stiffness_n_per_m: f64,
    /// The reference's own velocity, acceleration and the friction on the surface are fed forward.
    pub feed_forward: bool,
    /// Integral of the path's error across the normal, 1/s of the stiffness; 0: none, as published.
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
    /// Along the normal in use; otherwise along the tool's axis, as published.
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
    /// ξ, 1/deg: with θ in radians the published 0.08 would leave θ no say at all.
    pub xi_per_deg: f64,
    /// γ.
    pub gamma: f64,
    /// C_m; where it is found online, the one to begin with.
    pub margin: f64,
    /// C_m is found online: what the monitor shows while all is well, and this many standard
    /// deviations more; 0: C_m stays.
    pub margin_sd: f64,
    /// Time over which that is gathered, s.
    pub margin_time_s: f64,
    /// Least and greatest C_m found.
    pub margin_range: [f64; 2],
    /// ρ_min, 1/s.
    pub rho_min_per_s: f64,
    /// Rate of ρ_align, 1/s: 1 as published.
    pub rate_per_s: f64,
}

/// From the normal in use to the tool's orientation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OrientationConfig {
    /// T of eqs. (28)-(29), s: each new normal is turned to over this long. Where the normal's
    /// motion is fed forward, the time constant with which the rest is followed.
    pub follow_s: f64,
    /// Fastest turn of the reference, rad/s.
    pub turn_rate_max_rad_per_s: f64,
    /// Fastest change of that, rad/s²: what a normal that jumps may ask of the dampers.
    pub turn_acceleration_max_rad_per_s2: f64,
    /// The surface's own turning under the tool is fed forward from the curvature seen ahead.
    pub feed_forward: bool,
}

/// Force shaping.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShapingConfig {
    /// δ_c, m.
    pub margin_m: f64,
    /// x̃_z counts from where the tool touched last, not from the height at which the policy was
    /// laid: a tool that goes down with the surface has not lost it.
    pub from_last_contact: bool,
}

/// Both tanks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TankConfig {
    /// S_t,i.
    pub motion: EnergyTank,
    /// S_t,f.
    pub force: EnergyTank,
    /// Share of what the dampers take that is offered to the force tank; the motion tank is offered
    /// the rest.
    pub damping_share_to_force: f64,
    /// λ of eq. (38) goes from one side to the other over a speed at which a damper of this size
    /// takes the whole push, Ns/m: with the force tank's valve shut it is one.
    pub switch_n_s_per_m: f64,
    /// Most power that the motion tank's torques may be heading for, W.
    pub power_max_w: f64,
}

/// Vision and touch into one normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FusionConfig {
    /// Touch has a say; otherwise the camera alone, as published.
    pub touch: bool,
    /// A frame is carried along by the curvature it saw, filtered and doubted; otherwise it stands
    /// as it came until the next, as published.
    pub carry: bool,
    /// What stays of the camera's error however many frames are taken (its mounting), rad.
    pub vision_floor_rad: f64,
    /// What touch is never better than, rad.
    pub touch_floor_rad: f64,
    /// How well the curvature seen is known, 1/m.
    pub curvature_sd_per_m: f64,
    /// Standard deviations (and no less than 0.1 rad) by which a frame may surprise.
    pub gate_sd: f64,
    /// Frames in a row that surprise alike before they are believed.
    pub gate_frames: u32,
    /// Age of the newest frame beyond which the camera is blind, s.
    pub vision_patience_s: f64,
}

/// Where the spare joint goes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PostureConfig {
    /// Towards the middle of the joints' ranges, steeper near their ends, Nm/rad; 0: none, as
    /// published.
    pub stiffness_nm_per_rad: f64,
    /// Damping of what the tool does not see, Nm s/rad.
    pub damping_nm_s_per_rad: f64,
}

/// Meeting and losing the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TactileTouchConfig {
    /// Force above which the tool touches, N.
    pub on_n: f64,
    /// Force below which it does not, N...
    pub off_n: f64,
    /// ...for this many periods: then it is lost, and counted.
    pub lost_cycles: u32,
    /// For this many the policy stops.
    pub pause_cycles: u32,
    /// Losses after which the task ends.
    pub lost_count_max: u32,
    /// A lost surface is sought with the policy's clock stopped; otherwise the force controller
    /// alone brings the tool back, as published.
    pub seek: bool,
    /// Speed towards a surface that was lost, m/s.
    pub seek_speed_m_per_s: f64,
    /// Angle to the normal seen within which the approach begins, rad.
    pub aligned_rad: f64,
    /// Longest wait for that, s.
    pub align_s: f64,
    /// Time standing still over which the wrench's zero is taken, s.
    pub tare_s: f64,
    /// Largest force that this zero may be, N: beyond, the tool touches something or the load that
    /// the robot was told is wrong.
    pub zero_max_n: f64,
    /// How the zero drifts, N per minute: bounds the error of a zero of some age.
    pub zero_drift_n_per_min: f64,
    /// Least time between touchdown and path, s.
    pub settle_s: f64,
    /// Lag of the robot's wrench estimate, s: the friction taken off it gets the same.
    pub wrench_lag_s: f64,
}

impl Default for UnifiedForceImpedanceConfig {
    fn default() -> Self {
        Self {
            impedance: ImpedanceConfig::default(),
            force: ForceLoopConfig::default(),
            monitor: MonitorConfig::default(),
            orientation: OrientationConfig::default(),
            shaping: ShapingConfig::default(),
            tanks: TankConfig::default(),
            fusion: FusionConfig::default(),
            friction: FrictionConfig::default(),
            compensate_friction: true,
            posture: PostureConfig::default(),
            touch: TactileTouchConfig::default(),
            path: PathProfileConfig {
                acceleration_m_per_s2: 0.2,
                jerk_m_per_s3: 2.0,
                ..PathProfileConfig::default()
            },
            patience: PatienceConfig {
                wrench_jitter_s: 0.002,
                ..PatienceConfig::default()
            },
            // The robot's own estimate wanders by a newton or two while the joints move.
            leave: LeaveConfig {
                steady_n: 2.0,
                grow_n: 5.0,
                opposed_n: 8.0,
                opposed_nm: 3.0,
                ..LeaveConfig::default()
            },
        }
    }
}

impl Default for ImpedanceConfig {
    fn default() -> Self {
        Self {
            stiffness_n_per_m: [2500.0, 2500.0, 10.0],
            stiffness_nm_per_rad: [200.0; 3],
            damping_ratio: [1.0, 1.0, 0.7, 1.0, 1.0, 1.0],
            normal_damping_n_s_per_m: 300.0,
            free_stiffness_n_per_m: 1500.0,
            feed_forward: true,
            integral_per_s: 1.0,
            integral_max_n: 8.0,
        }
    }
}

impl Default for ForceLoopConfig {
    fn default() -> Self {
        Self {
            proportional: 0.1,
            integral_per_s: 3.0,
            integral_max_n: 15.0,
            filter_s: 0.02,
            along_normal: true,
            reference_rate_n_per_s: 40.0,
        }
    }
}

impl Default for MonitorConfig {
    fn default() -> Self {
        Self {
            alpha_per_j: 1.0,
            xi_per_deg: 0.08,
            gamma: 10.0,
            margin: 0.9,
            margin_sd: 4.0,
            margin_time_s: 2.0,
            margin_range: [0.3, 3.0],
            rho_min_per_s: 0.05,
            rate_per_s: 8.0,
        }
    }
}

impl Default for OrientationConfig {
    fn default() -> Self {
        Self {
            follow_s: 0.18,
            turn_rate_max_rad_per_s: 0.8,
            turn_acceleration_max_rad_per_s2: 6.0,
            feed_forward: true,
        }
    }
}

impl Default for ShapingConfig {
    fn default() -> Self {
        Self {
            margin_m: 0.04,
            from_last_contact: true,
        }
    }
}

impl Default for TankConfig {
    fn default() -> Self {
        Self {
            motion: EnergyTank {
                // Enough for twenty seconds against the published friction; x_t,i(0) = 7 of Table I
                // is 24.5 J.
                initial_j: 30.0,
                lower_j: 1.0,
                upper_j: 32.0,
                band_j: 2.0,
                reserve_j: 0.2,
            },
            force: EnergyTank {
                // x_t,f(0) = 2.
                initial_j: 2.0,
                lower_j: 1.0,
                upper_j: 2.0,
                band_j: 0.2,
                reserve_j: 0.1,
            },
            damping_share_to_force: 0.2,
            switch_n_s_per_m: 150.0,
            power_max_w: 30.0,
        }
    }
}

impl Default for FusionConfig {
    fn default() -> Self {
        Self {
            touch: true,
            carry: true,
            vision_floor_rad: 0.006,
            touch_floor_rad: 0.03,
            curvature_sd_per_m: 0.7,
            gate_sd: 4.0,
            gate_frames: 5,
            vision_patience_s: 0.3,
        }
    }
}

impl Default for PostureConfig {
    fn default() -> Self {
        Self {
            stiffness_nm_per_rad: 5.0,
            damping_nm_s_per_rad: 2.0,
        }
    }
}

impl Default for TactileTouchConfig {
    fn default() -> Self {
        Self {
            on_n: 3.0,
            off_n: 0.8,
            lost_cycles: 30,
            pause_cycles: 3,
            lost_count_max: 30,
            seek: true,
            seek_speed_m_per_s: 0.01,
            aligned_rad: 0.03,
            align_s: 4.0,
            tare_s: 0.3,
            zero_max_n: 5.0,
            zero_drift_n_per_min: 0.2,
            settle_s: 1.0,
            wrench_lag_s: 0.018,
        }
    }
}

impl UnifiedForceImpedanceConfig {
    /// Names that [`UnifiedForceImpedanceConfig::preset`] knows.
    pub const PRESETS: [&'static str; 2] = ["default", "paper"];

    /// A complete set of parameters: `default`, or `paper` (Table I).
    ///
    /// # Errors
    /// An unknown name.
    pub fn preset(name: &str) -> Result<Self, ControlError> {
        match name {
            "default" => Ok(Self::default()),
            "paper" => Ok(Self::paper()),
            other => Err(ControlError::UnknownPreset { name: other.into() }),
        }
    }

    /// A preset with single parameters changed, checked.
    ///
    /// # Errors
    /// An unknown name or parameter, or a value out of its range.
    pub fn preset_with(name: &str, changes: &toml::Table) -> Result<Self, ControlError> {
        let config = with_changes(Self::preset(name)?, changes)?;
        config.check()?;
        Ok(config)
    }

    fn paper() -> Self {
        let default = Self::default();
        Self {
            impedance: ImpedanceConfig {
                stiffness_n_per_m: [1000.0, 1000.0, 10.0],
                damping_ratio: [0.7, 0.7, 0.7, 1.0, 1.0, 1.0],
                // K_z = 10 N/m and a ratio of 0.7 alone leave 8 Ns/m, on which a stiff contact
                // bounces. 100 Ns/m, as it has across its axis, hold 50 kN/m; these hold four times
                // that.
                normal_damping_n_s_per_m: 250.0,
                feed_forward: false,
                integral_per_s: 0.0,
                free_stiffness_n_per_m: 1000.0,
                ..default.impedance
            },
            force: ForceLoopConfig {
                proportional: 0.6,
                integral_per_s: 0.3,
                // Without it K_p and the lag of the robot's own wrench estimate feed a stiff
                // contact more than its dampers take.
                filter_s: 0.05,
                along_normal: false,
                ..default.force
            },
            monitor: MonitorConfig {
                margin: 0.9,
                margin_sd: 0.0,
                rho_min_per_s: 0.001,
                rate_per_s: 1.0,
                ..default.monitor
            },
            orientation: OrientationConfig {
                follow_s: 0.12,
                feed_forward: false,
                ..default.orientation
            },
            shaping: ShapingConfig {
                margin_m: 0.04,
                from_last_contact: false,
            },
            tanks: TankConfig {
                motion: EnergyTank {
                    initial_j: 24.5,
                    ..default.tanks.motion
                },
                ..default.tanks
            },
            fusion: FusionConfig {
                touch: false,
                carry: false,
                ..default.fusion
            },
            compensate_friction: false,
            // Dampers alone would let an unconstrained joint drift for ever.
            posture: PostureConfig {
                stiffness_nm_per_rad: 0.0,
                ..default.posture
            },
            touch: TactileTouchConfig {
                seek: false,
                // ρ_align alone takes seven seconds to rise.
                align_s: 15.0,
                ..default.touch
            },
            ..default
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_in_range_and_the_paper_is_table_i() {
        for name in UnifiedForceImpedanceConfig::PRESETS {
            UnifiedForceImpedanceConfig::preset(name)
                .unwrap()
                .check()
                .unwrap();
        }
        let paper = UnifiedForceImpedanceConfig::preset("paper").unwrap();
        let i = paper.impedance;
        assert_eq!(i.stiffness_n_per_m, [1000.0, 1000.0, 10.0]);
        assert_eq!(i.stiffness_nm_per_rad, [200.0; 3]);
        assert_eq!(i.damping_ratio, [0.7, 0.7, 0.7, 1.0, 1.0, 1.0]);
        let m = paper.monitor;
        assert_eq!(
            (
                m.margin,
                m.alpha_per_j,
                m.xi_per_deg,
                m.gamma,
                m.rho_min_per_s
            ),
            (0.9, 1.0, 0.08, 10.0, 0.001)
        );
        let f = paper.force;
        assert_eq!((f.proportional, f.integral_per_s), (0.6, 0.3));
        assert_eq!(paper.shaping.margin_m, 0.04);
        let t = paper.tanks;
        assert_eq!(
            (t.motion.initial_j, t.motion.upper_j, t.motion.lower_j),
            (0.5 * 7.0 * 7.0, 32.0, 1.0)
        );
        assert_eq!(
            (t.force.initial_j, t.force.upper_j, t.force.lower_j),
            (0.5 * 2.0 * 2.0, 2.0, 1.0)
        );
        assert!(UnifiedForceImpedanceConfig::preset("best").is_err());
    }
}
