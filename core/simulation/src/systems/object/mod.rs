//! System `object` (Lippiello et al.): a torque-controlled arm with a force sensor and a camera on
//! an object of known shape, under the law `hybrid_dynamics`. Its scenarios are of kind
//! `object_pose`.

mod closed_loop;
mod plant;
mod plant_config;
pub mod reproduction;
mod scenario;

pub use closed_loop::{
    ObjectCycle, ObjectLoop, evaluate_object, evaluate_object_of, evaluate_object_with,
};
pub use plant::ObjectPlant;
pub use plant_config::{ObjectMotionConfig, ObjectPlantConfig};
pub use scenario::ObjectScenario;
