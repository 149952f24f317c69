//! Control laws, phases, tasks and paths, limits and guards: one step per robot cycle.
//!
//! Called by the `controller` service inside the robot's cycle, and by the closed loop of
//! `evaluate`.

pub mod admittance;
pub mod alignment;
mod answer;
mod clearance;
mod config;
mod controller;
mod departure;
pub mod energy_tank;
mod error;
mod estimator_choice;
pub mod force_integral;
pub mod force_law;
pub mod hybrid_dynamics;
mod interface;
pub mod joint_velocity;
mod leaving;
mod limits;
mod moving_base;
mod parameter;
mod path;
mod percept;
mod phases;
pub mod preflight;
mod profile;
mod program;
mod ranges;
mod response_guard;
mod run;
mod state_interval;
pub mod stiffness;
pub mod surface;
mod switching;
mod tare_permission;
mod task;
pub mod touchdown;
mod tracking;
pub mod unified_force_impedance;
mod urgent;
pub mod wrench_guard;

pub use clearance::{Clearance, LeaveConfig};
pub use config::{
    AlignmentConfig, ContactConfig, ControllerConfig, ForceConfig, NormalConfig, PathConfig,
    PathProfileConfig, PatienceConfig, TorqueConfig,
};
pub use controller::Controller;
pub use energy_tank::{EnergyTank, EnergyTankState};
pub use error::ControlError;
pub use estimator_choice::{EstimateStatus, EstimatorChoice};
pub use hybrid_dynamics::FrictionConfig;
pub use hybrid_dynamics::{HybridDynamics, HybridDynamicsConfig, HybridInput, HybridOutput};
pub use interface::{ControlInput, ControlOutput, EstimateInput, MAX_ESTIMATORS, UntaredLoad};
pub use limits::{Limits, TwistLimiter, clamp_norm};
pub use parameter::Parameter;
pub use path::{Circle, Line, Path, PathPlace, PathPoint, PathSpec, Raster, Stay, Waypoints};
pub use phases::{Fault, Phase};
pub use profile::Profile;
pub use program::{EstimatorName, EstimatorNames, Program};
pub use state_interval::StateInterval;
pub use switching::{ChoiceRules, SwitchCause, SwitchRefusal};
pub use tangent_schemas::CommandKind;
pub use tare_permission::{ContactSign, ControllerWord};
pub use task::{
    ApproachSpec, Direction, EndSpec, ForceSpec, PlaneSpec, SwitchingSpec, Task, TimeoutSpec,
    ToolAxis, ZeroAtLimit, ZeroSpec,
};
pub use unified_force_impedance::{
    BendChange, TankBooks, TorqueInterface, UnifiedForceImpedance, UnifiedForceImpedanceConfig,
    UnifiedInput, UnifiedOutput, VisionInput,
};
