//! Control laws, phases, tasks and paths, limits and guards: one step per robot cycle.
//!
//! Called by the `controller` service inside the robot's cycle, and by the closed loop of
//! `evaluate`.

pub mod contact;
pub mod coverage;
mod error;
mod estimator_choice;
mod inputs;
mod joint_move;
mod law;
pub mod laws;
pub mod learning;
mod leaving;
pub mod limits;
mod parameters;
mod phase_machine;
mod state_interval;
mod task;
mod verdict;

pub use contact::energy_tank::{EnergyTank, EnergyTankState};
pub use coverage::{Coverage, CoverageOutcome, CoverageResult, CoverageSpec};
pub use error::ControlError;
pub use estimator_choice::list::EstimatorList;
pub use estimator_choice::switching::{ChoiceRules, SwitchCause, SwitchRefusal};
pub use estimator_choice::{EstimateStatus, EstimatorChoice};
pub use inputs::{
    BendChange, EstimateInput, MAX_ESTIMATORS, ObjectInput, UntaredLoad, VisionInput,
};
pub use law::{EstimatorInUse, JointCommand, Law, LawInput, LawOutput, Shaping, Start};
pub use laws::hybrid_admittance::{
    AlignmentConfig, ContactConfig, ControlInput, ControlOutput, Controller, ControllerConfig,
    ForceConfig, NormalConfig, PathConfig, TorqueConfig,
};
pub use laws::hybrid_dynamics;
pub use laws::hybrid_dynamics::{HybridDynamics, HybridDynamicsConfig, HybridInput, HybridOutput};
pub use laws::torque_task::TorqueLaw;
pub use laws::unified_force_impedance;
pub use laws::unified_force_impedance::{
    TankBooks, TorqueInterface, UnifiedForceImpedance, UnifiedForceImpedanceConfig, UnifiedInput,
    UnifiedOutput,
};
pub use learning::{EndedPass, Learner, LearningSpec, Memory, MemoryError};
pub use leaving::clearance::Clearance;
pub use leaving::config::LeaveConfig;
pub use leaving::tare_permission::{ContactSign, ControllerWord};
pub use limits::faults::{Excess, Fault};
pub use limits::{Limits, TwistLimiter, clamp_norm};
pub use parameters::law_config::LawConfig;
pub use parameters::live::Parameter;
pub use parameters::presets::Presets;
pub use parameters::{FrictionConfig, PathProfileConfig, PatienceConfig};
pub use phase_machine::Phase;
pub use state_interval::StateInterval;
pub use tangent_schemas::CommandKind;
pub use task::path::{
    Circle, Line, Path, PathPlace, PathPoint, PathSpec, Raster, Stay, StrokeSpec, Strokes,
    Waypoints,
};
pub use task::preflight;
pub use task::profile::Profile;
pub use task::program::{EstimatorName, EstimatorNames, Program};
pub use task::region::{Pattern, Region, fill};
pub use task::{
    ApproachSpec, Direction, EndSpec, ExpectedSurface, ForceSpec, PlaneSpec, StartSpec,
    SwitchingSpec, Task, TimeoutSpec, Tolerances, ToolAxis, ZeroAtLimit, ZeroSpec,
};
pub use verdict::Verdict;
