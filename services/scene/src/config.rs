//! What the scene needs of a cell file.

use tangent_mechanics::urdf::{self, Mounted};
use tangent_mechanics::{Chain, ModelData, ModelError};
use tangent_runtime::CellConfig;

/// The arm, what it carries, and whose normals are shown.
#[derive(Clone, Debug)]
pub struct SceneConfig {
    /// Frames of the arm.
    pub chain: Chain,
    /// Sensor, tool and camera.
    pub mounted: Mounted,
    /// The arm with what it carries as a URDF.
    pub urdf: String,
    /// Estimators whose normals are shown.
    pub estimators: Vec<String>,
    /// Whether the base's place in the world is unknown until a platform publishes it.
    pub base_required: bool,
}

impl SceneConfig {
    /// Reads the configuration from a cell file.
    ///
    /// # Errors
    /// A value of the model is not allowed.
    pub fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ModelError> {
        let mounted = Mounted {
            flange_from_sensor: Some(cell.sensor.flange_from_sensor()),
            flange_from_tool: Some(cell.tool.flange_from_tool()),
            flange_from_camera: cell
                .camera
                .as_ref()
                .map(|camera| camera.flange_from_camera.pose()),
            tip: cell.tool.tip.tip(),
        };
        let mut estimators = vec![cell.estimators.active.clone()];
        for name in &cell.estimators.run {
            if !estimators.contains(name) {
                estimators.push(name.clone());
            }
        }
        Ok(Self {
            chain: Chain::new(model)?,
            urdf: urdf::urdf(model, &mounted)?,
            mounted,
            estimators,
            base_required: cell.base.required,
        })
    }
}
