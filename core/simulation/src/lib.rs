//! Models of surfaces, contact, friction, arms and sensors, and the closed loop of `evaluate`.
//!
//! There are three [`systems`]: `admittance`, `object` and `visuo_tactile`. Each has a plant, a
//! closed loop and the tables of the paper that it follows. Each [`Scenario`] belongs to one of
//! them.
//!
//! Called by the `simulator` service, which puts a plant behind sockets, and by
//! `tangent evaluate`, which closes the loop in one thread. Nothing here reads a clock; equal
//! configuration and seed give equal bits.

mod arms;
pub mod contact;
mod digest;
mod disturbance;
mod evaluation;
pub mod hardware_errors;
pub mod metrics;
mod overrides;
mod plant_error;
mod pose_config;
pub mod reproduction;
mod scenario;
mod scenario_file;
mod sensors;
mod start;
mod stated;
pub mod suite;
pub mod surfaces;
pub mod systems;
mod tool;
mod touch;
mod true_value;
mod truth;

pub use arms::loaded_arm::joints_of;
pub use arms::loaded_arm::stated_arm;
pub use arms::measurement::{ArmMeasurement, VelocityCommand};
pub use arms::platform::{OdometryConfig, OdometrySample, Platform, PlatformConfig};
pub use arms::servo::{Lag, Servo, ServoConfig};
pub use arms::torque_arm::{TorqueArm, TorqueArmConfig};
pub use contact::{
    ComplianceConfig, ContactConfig, FrictionConfig, FrictionModel, FrictionVariation, Obstacle,
    PadConfig,
};
pub use digest::TrajectoryDigest;
pub use disturbance::{Disturbance, Undisturbed};
pub use evaluation::Evaluation;
pub use hardware_errors::{
    ArmErrors, ErrorRanges, FrameErrors, HardwareErrors, TorqueArmErrors, TorqueErrors,
    WrenchErrors, WrenchEstimateErrors,
};
pub use overrides::OverrideError;
pub use plant_error::{PlantError, StartError};
pub use pose_config::PoseConfig;
pub use scenario::Scenario;
pub use scenario_file::{FileError, ReadFile, ScenarioError, no_files};
pub use sensors::camera::{Camera, CameraConfig, Exposure, FeatureSource, Imager};
pub use sensors::depth_camera;
pub use sensors::depth_source::DepthSource;
pub use sensors::fault::SensorFault;
pub use sensors::force_torque::{Sensor, SensorConfig};
pub use sensors::load::FlangeLoad;
pub use sensors::normal_camera::{NormalCamera, NormalCameraConfig};
pub use sensors::sample::SensorSample;
pub use sensors::target_image::ImageConfig;
pub use sensors::wrench_estimate::{ExternalWrenchConfig, WrenchEstimate};
pub use start::StartConfig;
pub use stated::StatedCell;
pub use surfaces::{ShapeConfig, Surface, SurfaceConfig, SurfacePoint};
pub use systems::admittance::{
    AdmittanceCycle, AdmittanceLoop, AdmittancePlant, AdmittancePlantConfig, AdmittanceScenario,
    PassEvaluation, PipelineConfig, evaluate_admittance, evaluate_admittance_pass,
    evaluate_admittance_passes, evaluate_admittance_samples, evaluate_admittance_with,
};
pub use systems::object::{
    ObjectCycle, ObjectLoop, ObjectMotionConfig, ObjectPlant, ObjectPlantConfig, ObjectScenario,
    evaluate_object, evaluate_object_of, evaluate_object_with,
};
pub use systems::visuo_tactile::{
    EnergyBooks, NormalSource, StartSpreadConfig, VisuoTactileCycle, VisuoTactileLoop,
    VisuoTactileMeasurement, VisuoTactilePlant, VisuoTactilePlantConfig, VisuoTactileScenario,
    evaluate_visuo_tactile, evaluate_visuo_tactile_of, evaluate_visuo_tactile_with,
};
pub use tool::{PayloadConfig, PayloadErrorConfig, ToolConfig};
pub use true_value::True;
pub use truth::Truth;
