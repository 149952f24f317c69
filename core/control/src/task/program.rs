//! A task made ready to run: checked, its path timed, its names in fixed capacity. Made outside the
//! loop.

use arrayvec::{ArrayString, ArrayVec};

use crate::error::ControlError;
use crate::inputs::MAX_ESTIMATORS;
use crate::laws::hybrid_admittance::ControllerConfig;
use crate::learning::{Learner, Memory, MemoryError};
use crate::parameters::law_config::LawConfig;
use crate::parameters::presets::Presets;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::path::Path;

/// An estimator's name, as in `estimate/NAME/normal`.
pub type EstimatorName = ArrayString<64>;
/// Estimators by order of preference.
pub type EstimatorNames = ArrayVec<EstimatorName, MAX_ESTIMATORS>;

/// A task made ready to run. Making one allocates; running it does not.
///
/// ```
/// use tangent_control::{ControllerConfig, Program, Task};
///
/// // Moves the tool off the surface; its path is to stay for one second.
/// let task = Task::leave(10.0);
/// let program = Program::new(&task, &ControllerConfig::default())?;
/// assert_eq!(program.path.duration_s(), 1.0);
/// assert_eq!(program.estimators[0].as_str(), "blend");
/// # Ok::<(), tangent_control::ControlError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Program<C = ControllerConfig> {
    /// Task from which the program was made.
    pub task: Task,
    /// Parameters of the law.
    pub config: C,
    /// The path over time.
    pub path: Path,
    /// Estimators by order of preference.
    pub estimators: EstimatorNames,
    /// What earlier passes learnt, and the record of this one; `None` if the task does not learn.
    pub learner: Option<Box<Learner>>,
}

impl<C: LawConfig> Program<C> {
    /// Checks the task and the parameters of its law, and times the path.
    ///
    /// # Errors
    /// A number is out of its range.
    pub fn with_config(task: &Task, config: C) -> Result<Self, ControlError> {
        task.check()?;
        config.check()?;
        let (acceleration, jerk) = config.path_bounds();
        let path = Path::new(&task.path, acceleration, jerk)?;
        let mut estimators = EstimatorNames::new();
        for name in &task.estimators {
            estimators.push(
                EstimatorName::from(name)
                    .map_err(|e| ControlError::range("estimators", e, "at most 64 bytes"))?,
            );
        }
        let learner = match &task.learning {
            Some(spec) if C::LEARNS => {
                let memory = Memory::new(&path);
                Some(Box::new(Learner::new(spec.clone(), memory)))
            }
            Some(spec) => {
                return Err(ControlError::range(
                    "learning.part",
                    format!("\"{}\"", spec.part),
                    "no `[learning]` with a torque-controlled arm: its laws do not learn",
                ));
            }
            None => None,
        };
        if task.home.is_some() && !C::TRAVELS {
            return Err(ControlError::range(
                "home",
                "set",
                "no `[home]` with a torque-controlled arm: its laws do not move it in joint space",
            ));
        }
        Ok(Self {
            task: task.clone(),
            config,
            path,
            estimators,
            learner,
        })
    }

    /// Starts from what earlier passes learnt. No effect on a task that does not learn. Allocates.
    ///
    /// # Errors
    /// The memory is of another path. The program is then unchanged, and learns anew.
    pub fn remember(&mut self, memory: Memory) -> Result<(), MemoryError> {
        if let (Some(spec), Some(learner)) = (&self.task.learning, &mut self.learner) {
            memory.check_path(&self.path)?;
            **learner = Learner::new(spec.clone(), memory);
        }
        Ok(())
    }
}

impl Program {
    /// First phase of a task that starts with a free tool.
    pub(crate) fn first_phase(&self) -> Phase {
        if self.task.start.is_some() && !self.task.only_leaves {
            Phase::Travel
        } else {
            self.task.phase_when_free()
        }
    }

    /// Checks the task and times its path. The task's own preset takes precedence over `config`.
    ///
    /// # Errors
    /// An unknown preset, or a number out of its range.
    pub fn new(task: &Task, config: &ControllerConfig) -> Result<Self, ControlError> {
        task.check()?;
        let config = match &task.controller {
            Some(name) => ControllerConfig::preset(name)?,
            None => *config,
        };
        Self::with_config(task, config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HybridDynamicsConfig;

    #[test]
    fn only_the_law_that_learns_takes_a_task_that_does() {
        let text = "name = \"a\"\nforce.reference_n = 3.0\nlearning.part = \"lid\"\n\
                    path = { kind = \"stay\", duration_s = 1.0 }";
        let task: Task = text.parse().unwrap();
        let program = Program::new(&task, &ControllerConfig::default()).unwrap();
        assert!(program.learner.is_some());
        let error = Program::with_config(&task, HybridDynamicsConfig::default()).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("learning.part") && error.contains("\"lid\""),
            "{error}"
        );
    }
}
