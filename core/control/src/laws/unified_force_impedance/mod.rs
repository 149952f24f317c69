//! `unified_force_impedance`: impedance and force control, both shaped by vision and touch and fed
//! from two energy tanks so that the arm stays passive. Karacan, Zhang, Sadeghian, Wu, Haddadin,
//! for torque-controlled arms of six joints or more.
//!
//! Called once per control period by the closed loop of `evaluate`, and by the service that holds
//! an arm's torque interface.

mod config;
mod controller;
mod energy;
mod fused_normal;
mod interface;
mod law;
mod monitor;
mod orientation;

pub use config::{
    ForceLoopConfig, FusionConfig, ImpedanceConfig, MonitorConfig, OrientationConfig,
    PostureConfig, ShapingConfig, TactileTouchConfig, TankConfig, UnifiedForceImpedanceConfig,
};
pub use controller::UnifiedForceImpedance;
pub use interface::{
    BendChange, TankBooks, TorqueInterface, UnifiedInput, UnifiedOutput, VisionInput,
};
