//! The `[plant]` table of a scenario: configuration of the simulated cell.

use serde::{Deserialize, Serialize};

use crate::platform::PlatformConfig;
use crate::pose_config::PoseConfig;
use crate::sensor_fault::SensorFault;
use crate::surfaces::ShapeConfig;

/// Configuration of the plant. It is stepped once per arm period.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantConfig {
    /// Built-in arm model; `ur5` by default.
    #[serde(default = "default_robot")]
    pub robot: String,
    /// Velocity servo and encoders.
    #[serde(default)]
    pub arm: ServoConfig,
    /// Longest sub-step of contact, s.
    #[serde(default = "default_substep")]
    pub substep_max_s: f64,
    /// The surface and its pose.
    pub surface: SurfaceConfig,
    /// Pad, compliance and payload on the sensor.
    #[serde(default)]
    pub tool: ToolConfig,
    /// Normal force and friction.
    #[serde(default)]
    pub contact: ContactConfig,
    /// Force/torque sensor.
    #[serde(default)]
    pub sensor: SensorConfig,
    /// Start pose of the arm.
    pub start: StartConfig,
    /// The mobile platform under the arm; a fixed base when absent.
    #[serde(default)]
    pub base: Option<PlatformConfig>,
}

fn default_robot() -> String {
    "ur5".to_owned()
}

fn default_substep() -> f64 {
    0.001
}

/// Velocity servo of the arm: a delay, an acceleration limit and a lag.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServoConfig {
    /// Time between packets, s: 0.008 on CB3, 0.002 on e-Series.
    pub period_s: f64,
    /// Whole periods between a command's arrival and the target velocity that follows it.
    pub input_delay_cycles: usize,
    /// Lag from target velocity to velocity.
    pub lag: Lag,
    /// Highest joint acceleration, whatever the command requests, rad/s².
    pub acceleration_max_rad_per_s2: f64,
    /// Resolution of measured joint positions, rad; 0 for none.
    pub encoder_resolution_rad: f64,
    /// Resolution of measured joint velocities, rad/s; 0 for none.
    pub velocity_resolution_rad_per_s: f64,
}

impl Default for ServoConfig {
    fn default() -> Self {
        Self::cb3()
    }
}

impl ServoConfig {
    /// CB3: 24-40 ms from command to measurable velocity, including the one cycle that a command
    /// waits for the program to read it.
    pub fn cb3() -> Self {
        Self {
            period_s: 0.008,
            input_delay_cycles: 1,
            lag: Lag::FirstOrder {
                time_constant_s: 0.012,
            },
            acceleration_max_rad_per_s2: 15.0,
            encoder_resolution_rad: 0.0,
            velocity_resolution_rad_per_s: 0.0,
        }
    }

    /// e-Series: 6-12 ms from command to measurable velocity in all.
    pub fn e_series() -> Self {
        Self {
            period_s: 0.002,
            input_delay_cycles: 1,
            lag: Lag::FirstOrder {
                time_constant_s: 0.005,
            },
            acceleration_max_rad_per_s2: 20.0,
            encoder_resolution_rad: 0.0,
            velocity_resolution_rad_per_s: 0.0,
        }
    }
}

/// Dynamics from target velocity to velocity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Lag {
    /// `T v' = v_target - v`
    FirstOrder {
        /// `T`, s.
        time_constant_s: f64,
    },
    /// `v'' = w² (v_target - v) - 2 z w v'`
    SecondOrder {
        /// `w`, rad/s.
        natural_frequency_rad_per_s: f64,
        /// `z`
        damping_ratio: f64,
    },
}

/// The surface and its pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceConfig {
    /// `base_from_surface`: origin, m.
    #[serde(default)]
    pub position_m: [f64; 3],
    /// `base_from_surface`: turns about the fixed x, then y, then z axis, rad.
    #[serde(default)]
    pub roll_pitch_yaw_rad: [f64; 3],
    /// Shape and dimensions.
    #[serde(flatten)]
    pub shape: ShapeConfig,
}

/// Tool and sensor on the flange.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ToolConfig {
    /// Pose of the sensor on the flange.
    pub flange_from_sensor: PoseConfig,
    /// Pose of the tool on the flange: origin at the middle of the pad, z out of the tool.
    pub flange_from_tool: PoseConfig,
    /// Contact pad.
    pub pad: PadConfig,
    /// Spring between flange and pad; rigid when absent.
    pub compliance: Option<ComplianceConfig>,
    /// Payload on the sensor, as stated in the cell file.
    pub payload: PayloadConfig,
    /// True payload minus `payload`: mass, kg, and centre of mass, m.
    pub payload_error: PayloadErrorConfig,
}

impl Default for ToolConfig {
    fn default() -> Self {
        Self {
            flange_from_sensor: PoseConfig {
                position_m: [0.0, 0.0, 0.045],
                ..PoseConfig::default()
            },
            flange_from_tool: PoseConfig {
                position_m: [0.0, 0.0, 0.165],
                ..PoseConfig::default()
            },
            pad: PadConfig::default(),
            compliance: None,
            payload: PayloadConfig::default(),
            payload_error: PayloadErrorConfig::default(),
        }
    }
}

/// A disk of contact points in the tool's xy plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PadConfig {
    /// Radius of the disk, m.
    pub radius_m: f64,
    /// Rings of points around the middle one: ring `i` has `6 i` points. 0 is a single point.
    pub rings: usize,
    /// Whether only the outermost ring touches.
    pub hollow: bool,
    /// Radius of the pad's crown, m: the rim is set back. Flat when absent.
    pub crown_radius_m: Option<f64>,
}

impl Default for PadConfig {
    fn default() -> Self {
        Self {
            radius_m: 0.008,
            rings: 2,
            hollow: false,
            crown_radius_m: None,
        }
    }
}

/// Series spring and damper between the flange and the pad, at the tool's origin, along tool axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ComplianceConfig {
    /// Translational stiffness `[x, y, z]`, N/m.
    pub stiffness_n_per_m: [f64; 3],
    /// Rotational stiffness `[x, y, z]`, Nm/rad.
    pub stiffness_nm_per_rad: [f64; 3],
    /// Damping over stiffness: time constant with which a deflection decays, s.
    pub relaxation_s: f64,
}

impl Default for ComplianceConfig {
    fn default() -> Self {
        Self {
            stiffness_n_per_m: [15_000.0, 15_000.0, 40_000.0],
            stiffness_nm_per_rad: [100.0, 100.0, 100.0],
            relaxation_s: 0.003,
        }
    }
}

/// Payload on the sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PayloadConfig {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
    /// Principal inertia about the centre of mass along sensor axes, kg m².
    pub inertia_kg_m2: [f64; 3],
}

impl Default for PayloadConfig {
    fn default() -> Self {
        Self {
            mass_kg: 0.3,
            com_in_sensor_m: [0.0, 0.0, 0.05],
            inertia_kg_m2: [4e-4, 4e-4, 1e-4],
        }
    }
}

/// Difference between the true payload and the one the cell file states.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PayloadErrorConfig {
    /// Error of the mass, kg.
    pub mass_kg: f64,
    /// Error of the centre of mass, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
}

/// Normal force and friction between pad and surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactConfig {
    /// Stiffness along the normal with the pad flat on the surface, as seen from the flange: pad
    /// and tool compliance in series, N/m.
    pub stiffness_n_per_m: f64,
    /// Hunt-Crossley exponent; 1 for a layer that is thin compared to the pad. With another
    /// exponent, `stiffness_n_per_m` holds at a depth of 1 mm.
    pub exponent: f64,
    /// Hunt-Crossley damping factor, s/m: `F = k x^e (1 + 1.5 a x')`.
    pub dissipation_s_per_m: f64,
    /// Friction law.
    pub friction: FrictionConfig,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            stiffness_n_per_m: 5_000.0,
            exponent: 1.0,
            dissipation_s_per_m: 4.0,
            friction: FrictionConfig::default(),
        }
    }
}

/// Friction per pad point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrictionConfig {
    /// `none`, `coulomb` or `lugre`.
    pub model: FrictionModel,
    /// Sliding friction coefficient.
    pub coulomb_coefficient: f64,
    /// Static friction coefficient.
    pub static_coefficient: f64,
    /// Stribeck speed, m/s.
    pub stribeck_m_per_s: f64,
    /// Viscous part, per unit of normal force, s/m.
    pub viscous_s_per_m: f64,
    /// LuGre bristle stiffness per unit of normal force, 1/m.
    pub bristle_stiffness_per_m: f64,
    /// LuGre bristle damping per unit of normal force, s/m.
    pub bristle_damping_s_per_m: f64,
}

impl Default for FrictionConfig {
    fn default() -> Self {
        Self {
            model: FrictionModel::Lugre,
            coulomb_coefficient: 0.25,
            static_coefficient: 0.3,
            stribeck_m_per_s: 0.003,
            viscous_s_per_m: 0.0,
            bristle_stiffness_per_m: 3_000.0,
            bristle_damping_s_per_m: 2.0,
        }
    }
}

/// Which friction law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrictionModel {
    /// Frictionless.
    None,
    /// Coulomb with Stribeck, a steep line through zero speed.
    Coulomb,
    /// Bristles: sticks, creeps before it slips (Canudas de Wit et al. 1995).
    #[default]
    Lugre,
}

/// Force/torque sensor. The default has no errors: ideal sensing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// Samples per second: 1000 in `evaluate`, 7000 live.
    pub rate_hz: f64,
    /// Counts per N, as in `cfgcpf` of the sensor box.
    pub counts_per_n: f64,
    /// Counts per Nm, as in `cfgcpt` of the sensor box.
    pub counts_per_nm: f64,
    /// Rated forces `[Fx, Fy, Fz]`, N. The gauges saturate slightly above; `[0, 0, 0]` never
    /// saturates.
    pub range_n: [f64; 3],
    /// Rated torques `[Tx, Ty, Tz]`, Nm. The gauges saturate slightly above; `[0, 0, 0]` never
    /// saturates.
    pub range_nm: [f64; 3],
    /// Smallest step of the force readings, N; 0 for that of the counts.
    pub resolution_n: [f64; 3],
    /// Smallest step of the torque readings, Nm; 0 for that of the counts.
    pub resolution_nm: [f64; 3],
    /// White noise of the forces, N/√Hz, one-sided: `σ = density √(rate/2)`.
    pub noise_n_per_sqrt_hz: f64,
    /// White noise of the torques, Nm/√Hz, one-sided: `σ = density √(rate/2)`.
    pub noise_nm_per_sqrt_hz: f64,
    /// Force zero of the untared sensor: standard deviation over seeds, N.
    pub bias_n: f64,
    /// Torque zero of the untared sensor: standard deviation over seeds, Nm.
    pub bias_nm: f64,
    /// Warm-up drift of the force zero, in a direction drawn from the seed, N.
    pub drift_n: f64,
    /// Warm-up drift of the torque zero, in a direction drawn from the seed, Nm.
    pub drift_nm: f64,
    /// Time constant of the warm-up, s.
    pub drift_time_constant_s: f64,
    /// Random walk of the force zero, N/√s.
    pub walk_n_per_sqrt_s: f64,
    /// Fault of the sensor and its start time; none when absent.
    pub fault: Option<SensorFault>,
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self::ideal()
    }
}

impl SensorConfig {
    /// Ideal sensor: no noise, no drift, no ranges, quantised only by the counts of the wire
    /// format.
    pub fn ideal() -> Self {
        Self {
            rate_hz: 1000.0,
            counts_per_n: 1e6,
            counts_per_nm: 1e6,
            range_n: [0.0; 3],
            range_nm: [0.0; 3],
            resolution_n: [0.0; 3],
            resolution_nm: [0.0; 3],
            noise_n_per_sqrt_hz: 0.0,
            noise_nm_per_sqrt_hz: 0.0,
            bias_n: 0.0,
            bias_nm: 0.0,
            drift_n: 0.0,
            drift_nm: 0.0,
            drift_time_constant_s: 10.0,
            walk_n_per_sqrt_s: 0.0,
            fault: None,
        }
    }

    /// ATI Gamma SI-130-10 on a Net F/T box, cold: ranges and resolution as rated, 0.3 N of drift.
    pub fn gamma() -> Self {
        Self {
            rate_hz: 1000.0,
            counts_per_n: 1e6,
            counts_per_nm: 1e6,
            range_n: [130.0, 130.0, 400.0],
            range_nm: [10.0; 3],
            resolution_n: [1.0 / 40.0, 1.0 / 40.0, 1.0 / 20.0],
            resolution_nm: [1.0 / 800.0; 3],
            noise_n_per_sqrt_hz: 0.002,
            noise_nm_per_sqrt_hz: 6e-5,
            bias_n: 2.0,
            bias_nm: 0.1,
            drift_n: 0.3,
            drift_nm: 0.01,
            drift_time_constant_s: 10.0,
            walk_n_per_sqrt_s: 0.005,
            fault: None,
        }
    }
}

/// Start pose of the tool, relative to the surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartConfig {
    /// The tool starts above the surface point closest to this point, base axes, m.
    pub near_m: [f64; 3],
    /// Gap between the tool's origin and the surface, m.
    #[serde(default = "default_clearance")]
    pub clearance_m: f64,
    /// Angle between `-z_tool` and the normal, rad.
    #[serde(default)]
    pub tilt_rad: f64,
    /// Direction of the tilt, about the tool's z axis from its x axis, rad.
    #[serde(default)]
    pub tilt_direction_rad: f64,
    /// Rotation of the tool about its own z axis, rad; at 0 its x axis is as close to the base's as
    /// possible.
    #[serde(default)]
    pub yaw_rad: f64,
    /// Joint positions from which inverse kinematics starts, one per joint, rad; the model's home
    /// position when absent.
    #[serde(default)]
    pub seed_rad: Option<Vec<f64>>,
}

fn default_clearance() -> f64 {
    0.01
}
