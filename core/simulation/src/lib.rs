//! Surfaces, contact, friction, arm and sensor models, and the closed loop of evaluate.
//!
//! Called by the `simulator` service, which puts the [`Plant`] behind sockets, and by `tangent evaluate`, which closes the
//! loop in one thread. Nothing here reads a clock; equal configuration and seed give equal bits.

mod closed_loop;
mod compliance;
pub mod contact;
mod cycle_line;
mod digest;
mod measurement;
pub mod metrics;
mod overrides;
mod plant;
mod plant_config;
mod scenario;
mod sensor;
mod sensor_load;
mod servo;
mod start;
pub mod surfaces;
mod truth;

pub use closed_loop::{ClosedLoop, Evaluation, LoopCycle, evaluate, evaluate_with};
pub use digest::TrajectoryDigest;
pub use measurement::{ArmMeasurement, SensorSample, VelocityCommand};
pub use overrides::OverrideError;
pub use plant::{Plant, PlantError};
pub use plant_config::{
    ComplianceConfig, ContactConfig, FrictionConfig, FrictionModel, Lag, PadConfig, PayloadConfig,
    PayloadErrorConfig, PlantConfig, PoseConfig, SensorConfig, ServoConfig, StartConfig,
    SurfaceConfig,
};
pub use scenario::{PipelineConfig, Scenario, ScenarioError};
pub use sensor::Sensor;
pub use servo::Servo;
pub use start::StartError;
pub use surfaces::{ShapeConfig, Surface, SurfacePoint};
pub use truth::Truth;
