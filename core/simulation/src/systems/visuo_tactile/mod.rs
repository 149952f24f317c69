//! System `visuo_tactile` (Karacan et al.): a torque-controlled arm with a camera and without a
//! force sensor on a surface of unknown shape, under the law `unified_force_impedance`. Its
//! scenarios are of kind `visuo_tactile`.

mod closed_loop;
mod plant;
mod plant_config;
pub mod reproduction;
mod scenario;

pub use closed_loop::{
    VisuoTactileCycle, VisuoTactileLoop, evaluate_visuo_tactile, evaluate_visuo_tactile_of,
    evaluate_visuo_tactile_with,
};
pub use plant::{EnergyBooks, VisuoTactileMeasurement, VisuoTactilePlant};
pub use plant_config::{NormalSource, StartSpreadConfig, VisuoTactilePlantConfig};
pub use scenario::VisuoTactileScenario;
