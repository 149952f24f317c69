//! The cell on which tasks are checked.

use std::path::Path;

use tangent_mechanics::ModelData;
use tangent_runtime::CellConfig;
use tangent_simulated_cell::{scenarios, take_arm};

use crate::error::CheckError;

/// A cell on which tasks are checked, and the joint positions of its arm.
pub struct OnCell {
    pub(crate) config: CellConfig,
    pub(crate) model: ModelData,
    pub(crate) start: Option<Vec<f64>>,
    /// Reason why there are no start positions, as text.
    pub(crate) no_start: String,
}

impl OnCell {
    /// Reads the cell file on which tasks are checked. `start` gives the joint positions at which
    /// they start, rad. If it is empty, they start where the cell's simulated scenario does.
    ///
    /// # Errors
    /// A bad cell file, or a start that does not fit its arm.
    pub fn load(path: &Path, start: &[f64]) -> Result<Self, CheckError> {
        let config = CellConfig::load(path).map_err(CheckError::Cell)?;
        let model = tangent_compose::model(&config)?;
        let mut cell = Self {
            start: (!start.is_empty()).then(|| start.to_vec()),
            no_start: "the start of the arm is not known offline: reach and workspace are checked when the task is \
                started, or here with --start".to_owned(),
            config,
            model,
        };
        if let Some(start) = &cell.start
            && start.len() != cell.model.dof
        {
            return Err(CheckError::Start {
                given: start.len(),
                arm: cell.model.name,
                wanted: cell.model.dof,
            });
        }
        if cell.start.is_none()
            && let Some(scenario) = &cell.config.simulator.scenario
        {
            let name = scenario.display().to_string();
            let mut played = scenarios::load(&name, &[]).map_err(CheckError::Scenario)?;
            take_arm(&mut played, &cell.config);
            match played.start_joints() {
                Ok(start) => cell.start = Some(start),
                Err(error) => cell.no_start = error.to_string(),
            }
        }
        Ok(cell)
    }
}
