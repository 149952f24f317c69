//! System `admittance` (Tugal et al.): a velocity-controlled arm with a force sensor on a surface
//! of unknown shape, under the law `hybrid_admittance`.

mod check;
mod closed_loop;
mod cycle_line;
mod passes;
mod plant;
mod plant_config;
pub mod reproduction;
mod scenario;

pub use closed_loop::{
    AdmittanceCycle, AdmittanceLoop, evaluate_admittance, evaluate_admittance_samples,
    evaluate_admittance_with,
};
pub use passes::{PassEvaluation, evaluate_admittance_pass, evaluate_admittance_passes};
pub use plant::AdmittancePlant;
pub use plant_config::AdmittancePlantConfig;
pub use scenario::{AdmittanceScenario, PipelineConfig};
