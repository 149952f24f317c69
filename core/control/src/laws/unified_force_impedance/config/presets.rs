//! Values of the parameters: the defaults, and the presets `paper` and `default`.

use super::{
    ForceLoopConfig, FusionConfig, ImpedanceConfig, MonitorConfig, OrientationConfig,
    PostureConfig, ShapingConfig, TactileTouchConfig, TankConfig, UnifiedForceImpedanceConfig,
};
use crate::contact::energy_tank::EnergyTank;
use crate::leaving::config::LeaveConfig;
use crate::parameters::presets::Presets;
use crate::parameters::{FrictionConfig, PathProfileConfig, PatienceConfig};

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
            // The robot's own estimate drifts by a newton or two while the joints move.
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
                // Enough for 20 s against the published friction; x_t,i(0) = 7 of Table I is 24.5
                // J.
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
            mounting_sd_rad: 0.01,
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
            lost_s: 0.03,
            pause_s: 0.003,
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

impl Presets for UnifiedForceImpedanceConfig {
    /// Table I.
    fn paper() -> Self {
        let default = Self::default();
        Self {
            impedance: ImpedanceConfig {
                stiffness_n_per_m: [1000.0, 1000.0, 10.0],
                damping_ratio: [0.7, 0.7, 0.7, 1.0, 1.0, 1.0],
                // K_z = 10 N/m and a ratio of 0.7 alone give 8 Ns/m, at which the tool bounces on a
                // stiff contact. 100 Ns/m, the value across the tool's axis, is stable up to 50
                // kN/m; the value here up to four times that.
                normal_damping_n_s_per_m: 250.0,
                feed_forward: false,
                integral_per_s: 0.0,
                free_stiffness_n_per_m: 1000.0,
                ..default.impedance
            },
            force: ForceLoopConfig {
                proportional: 0.6,
                integral_per_s: 0.3,
                // Without it, K_p and the lag of the robot's own wrench estimate feed more energy
                // into a stiff contact than the dampers dissipate.
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
                mounting_sd_rad: 0.0,
                ..default.fusion
            },
            compensate_friction: false,
            // Dampers alone would let an unconstrained joint drift indefinitely.
            posture: PostureConfig {
                stiffness_nm_per_rad: 0.0,
                ..default.posture
            },
            touch: TactileTouchConfig {
                seek: false,
                // ρ_align alone takes 7 s to rise.
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
    use crate::parameters::law_config::LawConfig;

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
