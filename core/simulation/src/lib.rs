//! Surfaces, contact, friction, arm and sensor models, and the closed loop of evaluate.
//!
//! Called by the `simulator` service, which puts the [`Plant`] behind sockets, and by `tangent evaluate`, which closes the
//! loop in one thread. Nothing here reads a clock; equal configuration and seed give equal bits.

mod compliance;
pub mod contact;
mod measurement;
mod plant;
mod plant_config;
mod sensor;
mod servo;
mod start;
pub mod surfaces;
mod truth;

pub use measurement::{ArmMeasurement, SensorSample, VelocityCommand};
pub use plant::{Plant, PlantError};
pub use plant_config::{
    ComplianceConfig, ContactConfig, FrictionConfig, FrictionModel, Lag, PadConfig, PayloadConfig,
    PayloadErrorConfig, PlantConfig, PoseConfig, SensorConfig, ServoConfig, StartConfig,
    SurfaceConfig,
};
pub use sensor::Sensor;
pub use servo::Servo;
pub use start::StartError;
pub use surfaces::{ShapeConfig, Surface, SurfacePoint};
pub use truth::Truth;
