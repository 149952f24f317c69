//! A task made ready to run: checked, its path timed, its names in fixed capacity. Made outside the
//! loop.

use arrayvec::{ArrayString, ArrayVec};

use crate::{ControlError, ControllerConfig, MAX_ESTIMATORS, Path, Phase, Task};

/// An estimator's name, as in `estimate/NAME/normal`.
pub type EstimatorName = ArrayString<64>;
/// Estimators by order of preference.
pub type EstimatorNames = ArrayVec<EstimatorName, MAX_ESTIMATORS>;

/// A task made ready to run. Making one allocates; running it does not.
#[derive(Clone, Debug)]
pub struct Program {
    /// What it was made from.
    pub task: Task,
    /// Parameters of the law it runs with.
    pub config: ControllerConfig,
    /// The path over time.
    pub path: Path,
    /// Estimators by order of preference.
    pub estimators: EstimatorNames,
}

impl Program {
    /// A task that starts with a free tool begins here.
    pub(crate) fn first_phase(&self) -> Phase {
        self.task.phase_when_free()
    }

    /// Checks the task and times its path. The task's own preset goes before `config`.
    pub fn new(task: &Task, config: &ControllerConfig) -> Result<Self, ControlError> {
        task.check()?;
        let config = match &task.controller {
            Some(name) => ControllerConfig::preset(name)?,
            None => *config,
        };
        config.check()?;
        let path = Path::new(
            &task.path,
            config.path.acceleration_m_per_s2,
            config.path.jerk_m_per_s3,
        )?;
        let mut estimators = EstimatorNames::new();
        for name in &task.estimators {
            estimators.push(
                EstimatorName::from(name)
                    .map_err(|e| ControlError::range("estimators", e, "at most 64 bytes"))?,
            );
        }
        Ok(Self {
            task: task.clone(),
            config,
            path,
            estimators,
        })
    }
}
