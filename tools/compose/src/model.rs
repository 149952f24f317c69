//! The arm model of a cell.

use std::fs;
use std::path::Path;

use tangent_mechanics::ModelData;
use tangent_runtime::CellConfig;

use crate::error::ComposeError;

/// The arm model that the cell file names: built in, or a file of the user.
///
/// # Errors
/// The name is unknown, or the file is invalid.
pub fn model(config: &CellConfig) -> Result<ModelData, ComposeError> {
    let robot = &config.robot;
    let model = match &robot.model_file {
        Some(path) => model_file(path),
        None => ModelData::builtin(&robot.model).map_err(ComposeError::ModelName),
    }?;
    robot.calibrated(model).map_err(ComposeError::refused)
}

/// Reads a model file of the user.
///
/// # Errors
/// The file cannot be read, or is not a model.
pub fn model_file(path: &Path) -> Result<ModelData, ComposeError> {
    let bad = |reason: String| ComposeError::ModelFile {
        path: path.to_owned(),
        reason,
    };
    let text = fs::read_to_string(path).map_err(|e| bad(e.to_string()))?;
    ModelData::from_toml(&text).map_err(|e| bad(e.to_string()))
}
