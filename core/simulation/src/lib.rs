//! Surfaces, contact, friction, arm and sensor models, and the closed loop of evaluate.
//!
//! Called by the `simulator` service, which puts the [`Plant`] behind sockets, and by
//! `tangent evaluate`, which closes the loop in one thread. Nothing here reads a clock; equal
//! configuration and seed give equal bits.

mod camera;
mod closed_loop;
mod compliance;
pub mod contact;
mod cycle_line;
pub mod depth_camera;
mod depth_source;
mod digest;
pub mod karacan;
pub mod lippiello;
mod loaded_arm;
mod measurement;
pub mod metrics;
mod normal_camera;
mod object_loop;
mod object_plant;
mod object_plant_config;
mod object_scenario;
mod obstacle;
mod overrides;
mod own_hold;
mod plant;
mod plant_config;
mod plant_error;
mod platform;
mod pose_config;
mod scenario;
mod sensor;
mod sensor_fault;
mod sensor_load;
mod sensor_records;
mod servo;
mod start;
pub mod surfaces;
mod tactile_loop;
mod tactile_plant;
mod tactile_plant_config;
mod tactile_scenario;
mod target_image;
mod torque_arm;
mod truth;
mod watched_sensor;
mod wrench_estimate;

pub use camera::{Camera, CameraConfig, Exposure, FeatureSource, Imager};
pub use closed_loop::{ClosedLoop, Evaluation, LoopCycle, evaluate, evaluate_with};
pub use depth_source::DepthSource;
pub use digest::TrajectoryDigest;
pub use loaded_arm::loaded_arm;
pub use measurement::{ArmMeasurement, SensorSample, VelocityCommand};
pub use normal_camera::{NormalCamera, NormalCameraConfig};
pub use object_loop::{
    Disturbance, ObjectCycle, ObjectLoop, Undisturbed, evaluate_object, evaluate_object_with,
};
pub use object_plant::ObjectPlant;
pub use object_plant_config::{ObjectMotionConfig, ObjectPlantConfig};
pub use object_scenario::{ObjectKind, ObjectScenario};
pub use obstacle::Obstacle;
pub use overrides::OverrideError;
pub use plant::Plant;
pub use plant_config::{
    ComplianceConfig, ContactConfig, FrictionConfig, FrictionModel, Lag, PadConfig, PayloadConfig,
    PayloadErrorConfig, PlantConfig, SensorConfig, ServoConfig, StartConfig, SurfaceConfig,
    ToolConfig,
};
pub use plant_error::{PlantError, StartError};
pub use platform::{OdometryConfig, OdometrySample, Platform, PlatformConfig};
pub use pose_config::PoseConfig;
pub use scenario::{PipelineConfig, Scenario, ScenarioError};
pub use sensor::Sensor;
pub use sensor_fault::SensorFault;
pub use servo::Servo;
pub use surfaces::{ShapeConfig, Surface, SurfacePoint};
pub use tactile_loop::{
    Calm, TactileCycle, TactileDisturbance, TactileLoop, evaluate_tactile, evaluate_tactile_with,
};
pub use tactile_plant::{EnergyBooks, TactileMeasurement, TactilePlant};
pub use tactile_plant_config::{NormalSource, StartSpreadConfig, TactilePlantConfig};
pub use tactile_scenario::{TactileKind, TactileScenario};
pub use target_image::ImageConfig;
pub use torque_arm::{TorqueArm, TorqueArmConfig};
pub use truth::Truth;
pub use wrench_estimate::{ExternalWrenchConfig, WrenchEstimate};
